#include "service/connection.hpp"

#include <chrono>
#include <nlohmann/json.hpp>
#include <thread>

#include "service/logs.hpp"
#include "service/session_config.hpp"
#include "service/shared_memory.hpp"

namespace armsight::vision::service {
namespace {

constexpr std::chrono::milliseconds kRetry{100};
constexpr int kHintAfterAttempts = 4;

}  // namespace

std::optional<Connection> connect(const Settings& settings, const std::string& robot, bool shared_memory,
                                  const std::atomic<bool>& stop) {
    zenoh::init_log();
    std::optional<zenoh::Config> config;
    std::string known;
    for (int attempt = 1; !stop; ++attempt) {
        const std::string in_the_way = shared_memory ? why_no_shared_memory(settings.robots.size()) : "";
        const bool has_it = shared_memory && in_the_way.empty();
        if (!config || in_the_way != known) {
            config = session_config(settings, robot, has_it);
            known = in_the_way;
            if (!has_it && shared_memory) log_warning("no shared memory: " + in_the_way);
        }
        try {
            return Connection{.robot = nlohmann::json::parse(config->get_json("namespace")).get<std::string>(),
                              .session = zenoh::Session::open(*config),
                              .shared_memory = has_it};
        } catch (const zenoh::ZException& error) {
            if (attempt % 20 == kHintAfterAttempts) {
                log_warning(
                    "no router yet, still trying: start one with `armsight up` or `armsight router`; with "
                    "certificates, `armsight status` with this --zenoh-config says what is wrong with them",
                    {{"endpoints", config->get_json("connect/endpoints")}, {"error", error.what()}});
            }
        }
        std::this_thread::sleep_for(kRetry);
    }
    return std::nullopt;
}

}  // namespace armsight::vision::service
