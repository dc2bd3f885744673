#include <atomic>
#include <csignal>
#include <exception>
#include <iostream>

#include "armsight/vision/backend.hpp"
#include "files/measure.hpp"
#include "files/pictures.hpp"
#include "service/codec.hpp"
#include "service/logs.hpp"
#include "service/service.hpp"
#include "service/settings.hpp"

namespace {

constexpr int kExitConfig = 2;  // starting again does not help

std::atomic<bool> stop_asked{false};  // NOLINT(cppcoreguidelines-avoid-non-const-global-variables): a signal sets it
static_assert(std::atomic<bool>::is_always_lock_free);

extern "C" void ask_to_stop(int /*signal*/) { stop_asked = true; }

}  // namespace

int main(int argc, const char* const* argv) {
    namespace service = armsight::vision::service;
    try {
        const auto settings = service::parse_settings(argc, argv);
        if (!settings) return 0;
        service::set_up_logging(settings->log_level);
        service::silence_protobuf();
        if (settings->files) {
            armsight::vision::files::measure(*settings->files, armsight::vision::classifier_of(settings->backend),
                                             std::cout);
            return 0;
        }
        if (settings->health) return service::probe(*settings);
        (void)std::signal(SIGTERM, ask_to_stop);
        (void)std::signal(SIGINT, ask_to_stop);
        return service::run(*settings, stop_asked);
    } catch (const service::ConfigError& error) {
        std::cerr << "vision: " << error.what() << '\n';
        return kExitConfig;
    } catch (const armsight::vision::files::FileError& error) {
        std::cerr << "vision: " << error.what() << '\n';
        return kExitConfig;
    } catch (const std::exception& error) {
        std::cerr << "vision: " << error.what() << '\n';
        return 1;
    }
}
