#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

namespace armsight::vision::service {

/// One JSON object a line on stderr, from `level` up (debug, info, warning, error).
void set_up_logging(const std::string& level);

/// A line with a message and fields of its own.
void log_info(std::string_view message, const nlohmann::json& fields = nlohmann::json::object());
void log_warning(std::string_view message, const nlohmann::json& fields = nlohmann::json::object());
void log_error(std::string_view message, const nlohmann::json& fields = nlohmann::json::object());

}  // namespace armsight::vision::service
