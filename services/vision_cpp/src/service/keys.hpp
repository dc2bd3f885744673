#pragma once

#include <string>
#include <string_view>

#include "armsight/topics.hpp"
#include "armsight/zenoh.hpp"

namespace armsight::vision::service {

/// A key of the table with {name} filled in (`*` for all).
[[nodiscard]] inline std::string key_for(std::string_view key, std::string_view name) {
    constexpr std::string_view kPlace = "{name}";
    std::string result(key);
    if (const auto at = result.find(kPlace); at != std::string::npos) result.replace(at, kPlace.size(), name);
    return result;
}

/// What stands for {name} in `camera/{name}/...`, whatever the session's namespace puts in front.
[[nodiscard]] inline std::string_view name_before_last(std::string_view key) {
    const auto last = key.rfind('/');
    if (last == std::string_view::npos || last == 0) return {};
    const auto before = key.rfind('/', last - 1);
    return key.substr(before == std::string_view::npos ? 0 : before + 1,
                      last - (before == std::string_view::npos ? 0 : before + 1));
}

[[nodiscard]] inline zenoh::PublisherOptions options_of(const topics::Topic& topic) {
    return {.block = topic.delivery == topics::Delivery::Block,
            .priority = topic.priority,
            .express = topic.express,
            .latched = topic.delivery == topics::Delivery::Latched};
}

}  // namespace armsight::vision::service
