#include "service/session_config.hpp"

#include <unistd.h>

#include <filesystem>
#include <nlohmann/json.hpp>
#include <regex>
#include <string>

namespace armsight::vision::service {
namespace {

using nlohmann::json;

// Zenoh's default of 2 loses a tenth of the frames at 30 Hz under load.
constexpr int kDataLowQueue = 16;

// How long a lost answer keeps a reader of a latched value from asking again.
constexpr int kLatchedPatienceMs = 1500;

// How soon a connection that is silent, or does not come about, is made anew: see proto/armsight/session.py.
constexpr int kLeaseMs = 3000;
constexpr int kOpenTimeoutMs = 2500;

// Files of TLS are named relative to the configuration, which so works wherever its folder is put. With one that is
// missing Zenoh would try again for ever.
void find_tls_files(zenoh::Config& config, const std::string& file) {
    for (const char* name : {"root_ca_certificate", "listen_certificate", "listen_private_key", "connect_certificate",
                             "connect_private_key"}) {
        const std::string path = std::string("transport/link/tls/") + name;
        const json named = json::parse(config.get_json(path));
        if (!named.is_string() || named.get<std::string>().empty()) continue;
        const auto found = std::filesystem::absolute(file).parent_path() / named.get<std::string>();
        if (access(found.c_str(), R_OK) != 0) {
            throw ConfigError(file + ": " + name + " " + found.string() + " is missing or can't be read by this user");
        }
        config.insert_json5(path, json(found.string()).dump());
    }
}

// A configuration of `armsight certs make` says whose it is: with another's the router lets nothing of ours pass.
void check_role(const zenoh::Config& config, const std::string& file) {
    const json metadata = json::parse(config.get_json("metadata"));
    if (!metadata.is_object() || !metadata.contains("role") || metadata["role"] == "vision") return;
    throw ConfigError(file + " and its certificate are for " + metadata["role"].dump() +
                      ", this is vision: the router would let it do what that may, and nothing else");
}

// Where in Zenoh's sources it failed helps nobody who set an option.
std::string reason(const zenoh::ZException& error) {
    return std::regex_replace(std::string(error.what()), std::regex(R"( at \S+\.rs:[0-9]+\.?)"), "");
}

}  // namespace

zenoh::Config session_config(const Settings& settings, const std::string& robot, bool shared_memory) {
    zenoh::Config config;
    std::vector<std::string> connect = settings.connect;
    std::string name_space = robot;
    try {
        if (!settings.zenoh_config.empty()) {
            config = zenoh::Config::from_file(settings.zenoh_config);
            check_role(config, settings.zenoh_config);
            find_tls_files(config, settings.zenoh_config);
            if (connect.empty()) {
                json endpoints = json::parse(config.get_json("connect/endpoints"));
                if (endpoints.is_object()) endpoints = endpoints.value("client", json());  // one list for each mode
                if (!endpoints.is_null()) connect = endpoints.get<std::vector<std::string>>();
            }
            const json in_file = json::parse(config.get_json("namespace"));
            if (name_space.empty() && in_file.is_string()) name_space = in_file.get<std::string>();
        }
        for (const std::string& endpoint : connect) check_endpoint(endpoint);
        if (connect.empty()) connect.emplace_back(kDefaultEndpoint);
        if (name_space.empty()) name_space = kDefaultNamespace;
        const auto put = [&](std::string_view path, const json& value) { config.insert_json5(path, value.dump()); };
        put("mode", "client");
        put("scouting/multicast/enabled", false);
        put("scouting/gossip/enabled", false);
        put("transport/link/tx/queue/size/data_low", kDataLowQueue);
        put("queries_default_timeout", kLatchedPatienceMs);
        put("transport/link/tx/lease", kLeaseMs);
        put("transport/unicast/open_timeout", kOpenTimeoutMs);
        put("connect/endpoints", connect);
        put("connect/timeout_ms", 500);
        put("connect/exit_on_failure", true);
        put("connect/retry", {{"period_init_ms", 100}, {"period_max_ms", 500}, {"period_increase_factor", 1.5}});
        put("listen/endpoints", json::array());
        put("namespace", name_space);
        put("transport/shared_memory/enabled", shared_memory);
        put("transport/shared_memory/transport_optimization/enabled", false);
    } catch (const zenoh::ZException& error) {
        throw ConfigError("zenoh refuses the configuration: " + reason(error));
    } catch (const json::exception& error) {
        throw ConfigError(settings.zenoh_config + " has endpoints or a namespace of the wrong kind: " + error.what());
    }
    return config;
}

}  // namespace armsight::vision::service
