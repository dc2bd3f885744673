#include "service/pairing.hpp"

#include <algorithm>
#include <utility>

namespace armsight::vision::service {
namespace {

bool has(const Instant& instant, const std::string& camera) {
    return std::ranges::any_of(instant.frames, [&](const Frame& frame) { return frame.camera == camera; });
}

}  // namespace

Pairing::Pairing(const std::vector<std::string>& cameras) {
    for (const std::string& camera : cameras) misses_[camera] = 0;
}

void Pairing::add(Frame frame, SteadyTime now) {
    const auto known = misses_.find(frame.camera);
    if (known == misses_.end()) return;
    known->second = 0;
    auto instant = std::ranges::find(pending_, frame.capture_ns, &Instant::capture_ns);
    if (instant == pending_.end()) {
        if (is_full()) drop_oldest();
        pending_.push_back({.capture_ns = frame.capture_ns, .frames = {}, .since = now});
        instant = std::prev(pending_.end());
    }
    std::erase_if(instant->frames, [&](const Frame& other) { return other.camera == frame.camera; });
    instant->frames.push_back(std::move(frame));
}

std::optional<Instant> Pairing::take(SteadyTime now) {
    std::optional<std::size_t> chosen;
    for (std::size_t i = 0; i < pending_.size(); ++i) {
        if (!is_complete(pending_[i])) continue;
        if (!chosen || now - pending_[*chosen].since >= kWorth) chosen = i;
    }
    if (chosen) return remove_until(*chosen);
    // newer instants wait as well, and none is complete: what is missing will not come
    if (is_full() || (!pending_.empty() && now - pending_.front().since >= kPatience)) return remove_until(0);
    return std::nullopt;
}

std::optional<SteadyTime> Pairing::due() const {
    if (pending_.empty()) return std::nullopt;
    const bool is_now =
        is_full() || std::ranges::any_of(pending_, [&](const Instant& one) { return is_complete(one); });
    return pending_.front().since + (is_now ? SteadyTime::duration{} : kPatience);
}

std::vector<std::string> Pairing::gone() const {
    std::vector<std::string> result;
    for (const auto& [camera, misses] : misses_) {
        if (misses >= kMissesUntilGone) result.push_back(camera);
    }
    return result;
}

bool Pairing::is_complete(const Instant& instant) const {
    return std::ranges::all_of(
        misses_, [&](const auto& entry) { return entry.second >= kMissesUntilGone || has(instant, entry.first); });
}

Instant Pairing::remove_until(std::size_t index) {
    for (std::size_t i = 0; i < index; ++i) drop_oldest();
    Instant instant = std::move(pending_.front());
    pending_.pop_front();
    for (auto& [camera, misses] : misses_) {
        if (!has(instant, camera)) ++misses;
    }
    // the same order in every run, whatever came first: equal input gives equal bits
    std::ranges::sort(instant.frames, {}, &Frame::camera);
    return instant;
}

void Pairing::drop_oldest() {
    dropped_ += pending_.front().frames.size();
    pending_.pop_front();
}

}  // namespace armsight::vision::service
