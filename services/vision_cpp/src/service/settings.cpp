#include "service/settings.hpp"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <regex>
#include <sstream>
#include <utility>
#include <vector>

namespace armsight::vision::service {
namespace {

std::string environment(const char* name) {
    const char* value = std::getenv(name);  // NOLINT(concurrency-mt-unsafe): before any thread is started
    return value == nullptr ? "" : value;
}

std::vector<std::string> split(const std::string& text, char separator) {
    std::vector<std::string> parts;
    std::stringstream stream(text);
    for (std::string part; std::getline(stream, part, separator);) {
        if (!part.empty()) parts.push_back(part);
    }
    return parts;
}

void check_namespace(const std::string& name) {
    const bool has_empty_part = name.starts_with('/') || name.ends_with('/') || name.find("//") != std::string::npos;
    if (has_empty_part || name.find_first_of("*$?#") != std::string::npos) {
        throw ConfigError("namespace '" + name + "' is not a key such as '" + kDefaultNamespace + "'");
    }
}

void check_namespaces(const std::vector<std::string>& names) {
    for (auto name = names.begin(); name != names.end(); ++name) {
        check_namespace(*name);
        if (std::find(names.begin(), name, *name) != name) {
            throw ConfigError("namespace '" + *name + "' is given twice");
        }
    }
}

std::vector<std::pair<std::string, std::filesystem::path>> named_files(const std::vector<std::string>& images) {
    std::vector<std::pair<std::string, std::filesystem::path>> result;
    for (const std::string& image : images) {
        const auto equals = image.find('=');
        if (equals == 0 || equals == std::string::npos || equals + 1 == image.size()) {
            throw ConfigError("--image '" + image + "' is not of the form NAME=FILE");
        }
        result.emplace_back(image.substr(0, equals), image.substr(equals + 1));
    }
    return result;
}

}  // namespace

void check_endpoint(const std::string& endpoint) {
    // protocols whose address is a host and a port; what others want only Zenoh knows
    static const std::regex host_and_port("(tcp|udp|tls|quic|ws)/.+:([0-9]{1,5})([?#].*)?");
    static const std::regex other("(?!(tcp|udp|tls|quic|ws)/)[^/]+/.+");
    std::smatch match;
    bool is_valid = std::regex_match(endpoint, other);
    if (std::regex_match(endpoint, match, host_and_port)) {
        const int port = std::stoi(match[2]);
        is_valid = port > 0 && std::in_range<std::uint16_t>(port);
    }
    if (!is_valid) throw ConfigError("endpoint '" + endpoint + "' is not of the form tcp/HOST:PORT");
}

std::optional<Settings> parse_settings(int argc, const char* const* argv) {
    Settings settings;
    CLI::App app("Measures the markers' 3D positions in the camera frames on the bus.", "armsight-vision");
    app.add_option("--connect", settings.connect,
                   "router to connect to, may be given again (environment ARMSIGHT_CONNECT, default " +
                       std::string(kDefaultEndpoint) + ")")
        ->type_name("ENDPOINT");
    app.add_option("--namespace", settings.robots,
                   "the robot's name, may be given again to serve several (environment ARMSIGHT_NAMESPACE, with commas "
                   "between them, default " +
                       std::string(kDefaultNamespace) + ")")
        ->type_name("KEY");
    app.add_option("--zenoh-config", settings.zenoh_config, "Zenoh JSON5 file (environment ARMSIGHT_ZENOH_CONFIG)")
        ->type_name("FILE");
    app.add_option("--log-level", settings.log_level, "default: warning")
        ->check(CLI::IsMember({"debug", "info", "warning", "error"}))
        ->type_name("LEVEL");
    app.add_option("--backend", settings.backend,
                   "what finds the markers' pixels: simd, or opencv for the plain form, which finds the same and takes "
                   "several hundred times as long (default: simd)")
        ->check(CLI::IsMember({"simd", "opencv"}))
        ->type_name("NAME");
    app.add_flag("--health", settings.health, "ask the running service whether it answers, and exit");
    files::FileInput input;
    std::vector<std::string> images;
    auto* from_files = app.add_option_group("Without a bus",
                                            "measures the markers in pictures of one instant; prints "
                                            "armsight.v1.JointPositions as JSON");
    auto* calibration = from_files->add_option("--calibration", input.calibration,
                                               "JSON file with the description and the cameras, such as `armsight "
                                               "snapshot` writes");
    auto* image = from_files->add_option("--image", images, "a camera's PNG or JPEG picture; once for each camera");
    auto* out = from_files->add_option("--out", input.out, "folder for the pictures with what was found drawn in");
    calibration->type_name("FILE")->needs(image);
    image->type_name("NAME=FILE")->needs(calibration);
    out->type_name("DIR")->needs(image);
    try {
        app.parse(argc, argv);
    } catch (const CLI::CallForHelp&) {
        std::cout << app.help();
        return std::nullopt;
    } catch (const CLI::ParseError& error) {
        throw ConfigError(std::string(error.what()) + "; see --help");
    }
    if (settings.connect.empty()) settings.connect = split(environment("ARMSIGHT_CONNECT"), ',');
    if (settings.robots.empty()) settings.robots = split(environment("ARMSIGHT_NAMESPACE"), ',');
    if (settings.robots.empty()) settings.robots.emplace_back();
    if (settings.zenoh_config.empty()) settings.zenoh_config = environment("ARMSIGHT_ZENOH_CONFIG");
    settings.shared_memory = environment("ARMSIGHT_SHARED_MEMORY") != "off";
    if (!images.empty()) {
        input.images = named_files(images);
        settings.files = input;
    }
    for (const std::string& endpoint : settings.connect) check_endpoint(endpoint);
    check_namespaces(settings.robots);
    return settings;
}

}  // namespace armsight::vision::service
