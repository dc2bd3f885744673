#include "service/logs.hpp"

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <chrono>
#include <ctime>
#include <memory>

namespace armsight::vision::service {
namespace {

std::string now_text() {
    const auto now = std::chrono::system_clock::now();
    const auto seconds = std::chrono::floor<std::chrono::seconds>(now);
    const auto ms = std::chrono::duration_cast<std::chrono::milliseconds>(now - seconds).count();
    const std::time_t time = std::chrono::system_clock::to_time_t(seconds);
    std::tm utc{};
    gmtime_r(&time, &utc);
    return fmt::format("{:04}-{:02}-{:02}T{:02}:{:02}:{:02}.{:03}Z", utc.tm_year + 1900, utc.tm_mon + 1, utc.tm_mday,
                       utc.tm_hour, utc.tm_min, utc.tm_sec, ms);
}

void log(spdlog::level::level_enum level, std::string_view name, std::string_view message,
         const nlohmann::json& fields) {
    if (!spdlog::should_log(level)) return;
    nlohmann::ordered_json line{{"time", now_text()}, {"level", name}, {"service", "vision"}, {"message", message}};
    for (const auto& [key, value] : fields.items()) line[key] = value;
    // texts may come from the bus: bytes that are not UTF-8 are replaced
    spdlog::log(level, line.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace));
}

}  // namespace

void set_up_logging(const std::string& level) {
    auto logger = std::make_shared<spdlog::logger>("vision", std::make_shared<spdlog::sinks::stderr_sink_mt>());
    logger->set_pattern("%v");
    logger->set_level(spdlog::level::from_str(level));
    logger->flush_on(spdlog::level::debug);
    spdlog::set_default_logger(std::move(logger));
}

void log_info(std::string_view message, const nlohmann::json& fields) {
    log(spdlog::level::info, "info", message, fields);
}
void log_warning(std::string_view message, const nlohmann::json& fields) {
    log(spdlog::level::warn, "warning", message, fields);
}
void log_error(std::string_view message, const nlohmann::json& fields) {
    log(spdlog::level::err, "error", message, fields);
}

}  // namespace armsight::vision::service
