#include <atomic>
#include <csignal>
#include <cstdio>
#include <exception>

#include "service/logs.hpp"
#include "service/service.hpp"
#include "service/settings.hpp"

namespace {

constexpr int kExitConfig = 2;  // starting again does not help

std::atomic<bool> stop_asked{false};  // NOLINT(cppcoreguidelines-avoid-non-const-global-variables): a signal sets it
static_assert(std::atomic<bool>::is_always_lock_free);

extern "C" void ask_to_stop(int) { stop_asked = true; }

}  // namespace

int main(int argc, char** argv) {
    namespace service = armsight::vision::service;
    try {
        const auto settings = service::parse_settings(argc, argv);
        if (!settings) return 0;
        service::set_up_logging(settings->log_level);
        if (settings->health) return service::probe(*settings);
        std::signal(SIGTERM, ask_to_stop);
        std::signal(SIGINT, ask_to_stop);
        return service::run(*settings, stop_asked);
    } catch (const service::ConfigError& error) {
        std::fprintf(stderr, "vision: %s\n", error.what());
        return kExitConfig;
    } catch (const std::exception& error) {
        std::fprintf(stderr, "vision: %s\n", error.what());
        return 1;
    }
}
