#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "armsight/vision/frame.hpp"
#include "service/turns.hpp"

namespace armsight::vision::service {

/// One image as it came.
struct Frame {
    std::string camera;
    std::int64_t capture_ns;
    std::uint64_t sent_ns, received_ns;  ///< wall clocks of sender and receiver, Unix nanoseconds
    ImageView image;
    std::shared_ptr<const void> owner;  ///< of the image's bytes
};

/// All images of one instant.
struct Instant {
    std::int64_t capture_ns;
    std::vector<Frame> frames;
    SteadyTime since;  ///< arrival of the first
};

/// Waits for the frames of one capture time to be complete; either may be lost alone. An instant that stays incomplete
/// is given out with what is there after kPatience, or when kMaxPending of them wait. Where several are complete they
/// are given out in order, unless the first has waited for kWorth: then the newest, and those before it are dropped.
/// A camera that missed several instants in a row is not waited for. Not safe from several threads: the caller locks.
class Pairing {
  public:
    static constexpr std::chrono::milliseconds kPatience{250};
    /// As long as a command is valid: an answer that is later moves no arm.
    static constexpr std::chrono::milliseconds kWorth{100};
    static constexpr int kMissesUntilGone = 3;
    static constexpr std::size_t kMaxPending = 4;

    explicit Pairing(const std::vector<std::string>& cameras);

    /// Takes a frame; frames of unknown cameras are left out, a second one of the same instant replaces the first.
    void add(Frame frame, SteadyTime now);

    /// The next instant that is complete, or has waited long enough.
    [[nodiscard]] std::optional<Instant> take(SteadyTime now);

    /// From when on take() gives one, if no more frames come; nothing when none waits.
    [[nodiscard]] std::optional<SteadyTime> due() const;

    /// Frames that were dropped because their partners never came, or nobody took them in time.
    [[nodiscard]] std::uint64_t dropped() const { return dropped_; }

    /// Cameras that are not waited for any more.
    [[nodiscard]] std::vector<std::string> gone() const;

  private:
    [[nodiscard]] bool is_complete(const Instant& instant) const;
    [[nodiscard]] bool is_full() const { return pending_.size() >= kMaxPending; }
    [[nodiscard]] Instant remove_until(std::size_t index);
    void drop_oldest();

    std::map<std::string, int> misses_;  ///< instants in a row without a frame of this camera
    std::deque<Instant> pending_;
    std::uint64_t dropped_ = 0;
};

}  // namespace armsight::vision::service
