#include "service/turns.hpp"

#include <algorithm>

namespace armsight::vision::service {

void Rota::due(std::size_t robot, SteadyTime when) {
    Entry& entry = robots_.at(robot);
    entry.due = std::min(entry.due, when);
}

std::optional<std::size_t> Rota::take(SteadyTime now) {
    for (std::size_t i = 0; i < robots_.size(); ++i) {
        const std::size_t robot = (next_ + i) % robots_.size();
        Entry& entry = robots_[robot];
        if (entry.is_taken || entry.due > now) continue;
        entry = {.due = SteadyTime::max(), .is_taken = true};
        next_ = (robot + 1) % robots_.size();
        return robot;
    }
    return std::nullopt;
}

void Rota::give_back(std::size_t robot, SteadyTime again) {
    robots_.at(robot).is_taken = false;
    due(robot, again);
}

std::optional<SteadyTime> Rota::next_due() const {
    std::optional<SteadyTime> result;
    for (const Entry& entry : robots_) {
        if (!entry.is_taken) result = std::min(result.value_or(SteadyTime::max()), entry.due);
    }
    return result;
}

void Turns::wake(std::size_t robot) {
    {
        const std::scoped_lock lock(mutex_);
        rota_.due(robot, std::chrono::steady_clock::now());
    }
    changed_.notify_one();
}

std::optional<std::size_t> Turns::take(SteadyTime until) {
    std::unique_lock lock(mutex_);
    while (!is_closed_) {
        const auto now = std::chrono::steady_clock::now();
        if (const auto robot = rota_.take(now)) return robot;
        if (now >= until) return std::nullopt;
        changed_.wait_until(lock, std::min(until, rota_.next_due().value_or(until)));
    }
    return std::nullopt;
}

void Turns::give_back(std::size_t robot, SteadyTime again) {
    {
        const std::scoped_lock lock(mutex_);
        rota_.give_back(robot, again);
    }
    // whoever sleeps may have gone to sleep for longer than until then
    changed_.notify_one();
}

void Turns::close() {
    {
        const std::scoped_lock lock(mutex_);
        is_closed_ = true;
    }
    changed_.notify_all();
}

}  // namespace armsight::vision::service
