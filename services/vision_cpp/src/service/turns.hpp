#pragma once

#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <mutex>
#include <optional>
#include <vector>

namespace armsight::vision::service {

using SteadyTime = std::chrono::steady_clock::time_point;

/// Whose turn it is: the robots that have something to do, one after the other, however much each of them has. Between
/// two turns of one, every other that is due has had its own. A robot is in one pair of hands at a time.
/// Not safe from several threads: the caller locks.
class Rota {
  public:
    /// Robots are counted from 0; every one of them is due from the beginning.
    explicit Rota(std::size_t robots) : robots_(robots) {}

    /// The robot has something to do from `when` on, or from before that, as known already.
    void due(std::size_t robot, SteadyTime when);

    /// Hands out the next robot that is due and in nobody's hands.
    [[nodiscard]] std::optional<std::size_t> take(SteadyTime now);

    /// Takes it back. It is due again at `again`, or sooner if it became due in between.
    void give_back(std::size_t robot, SteadyTime again);

    /// When the next of those in nobody's hands is due; nothing when all are in somebody's.
    [[nodiscard]] std::optional<SteadyTime> next_due() const;

  private:
    struct Entry {
        SteadyTime due;
        bool is_taken = false;
    };
    std::vector<Entry> robots_;
    std::size_t next_ = 0;  ///< who is asked first
};

/// The same for several threads, which sleep while no robot is due.
class Turns {
  public:
    explicit Turns(std::size_t robots) : rota_(robots) {}

    /// The robot has something to do now.
    void wake(std::size_t robot);

    /// Waits for the next robot that is due; nothing when there is none until `until`, and once this is closed.
    [[nodiscard]] std::optional<std::size_t> take(SteadyTime until);

    /// See Rota.
    void give_back(std::size_t robot, SteadyTime again);

    /// Ends every take().
    void close();

  private:
    std::mutex mutex_;
    std::condition_variable changed_;
    Rota rota_;
    bool is_closed_ = false;
};

}  // namespace armsight::vision::service
