#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <string_view>

namespace armsight::vision::service {

/// Named totals since start, shown in health; safe from every thread.
class Counters {
  public:
    /// Adds one and returns the total.
    std::uint64_t add(std::string_view name);
    [[nodiscard]] std::map<std::string, std::uint64_t> snapshot() const;

  private:
    mutable std::mutex mutex_;
    std::map<std::string, std::uint64_t> totals_;
};

/// The 1st, 2nd, 4th, 8th, … time: a flood of the same complaint stays readable in the log.
[[nodiscard]] constexpr bool is_worth_a_line(std::uint64_t total) { return (total & (total - 1)) == 0; }

}  // namespace armsight::vision::service
