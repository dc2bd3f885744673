#pragma once

#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "files/measure.hpp"

namespace armsight::vision::service {

/// Flags, environment or files that cannot be used: starting again does not help (exit code 2).
class ConfigError : public std::runtime_error {
  public:
    using std::runtime_error::runtime_error;
};

inline constexpr const char* kDefaultEndpoint = "tcp/127.0.0.1:7447";
inline constexpr const char* kDefaultNamespace = "robots/arm";

/// What flags and environment say. A flag wins over its environment variable, that over the file, that over the
/// default.
struct Settings {
    std::vector<std::string> connect;       ///< endpoints of the router; empty: the file's or the default
    std::vector<std::string> robots;        ///< their names, at least one; an empty one is the file's or the default
    std::string zenoh_config;               ///< path of a Zenoh JSON5 file, or empty
    std::string log_level = "warning";      ///< debug, info, warning or error
    std::string backend = "simd";           ///< what finds the markers' pixels: simd or opencv
    bool shared_memory = true;              ///< use it where this process may lock enough memory
    bool health = false;                    ///< ask the running service whether it answers, and exit
    std::optional<files::FileInput> files;  ///< measure these, without a bus, and exit
};

/// Throws ConfigError where Zenoh would only try for ever.
void check_endpoint(const std::string& endpoint);

/// Parses the command line. Returns nothing when help was asked for and printed.
/// Throws ConfigError with one line on what is wrong.
[[nodiscard]] std::optional<Settings> parse_settings(int argc, const char* const* argv);

}  // namespace armsight::vision::service
