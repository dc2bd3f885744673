#include "service/counters.hpp"

namespace armsight::vision::service {

std::uint64_t Counters::add(std::string_view name) {
    const std::scoped_lock lock(mutex_);
    return ++totals_[std::string(name)];
}

std::map<std::string, std::uint64_t> Counters::snapshot() const {
    const std::scoped_lock lock(mutex_);
    return totals_;
}

}  // namespace armsight::vision::service
