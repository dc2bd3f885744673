#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "armsight/vision/triangulate.hpp"

namespace armsight::vision {

/// What is remembered of one marker between instants, for those at which one camera or none sees it: a Kalman filter
/// over position and velocity, driven by accelerations that nobody knows.
class Track {
  public:
    /// Where the marker should be, with a covariance that has grown since it was seen; nothing when never seen.
    [[nodiscard]] std::optional<Prior> predict(std::int64_t capture_ns) const;

    /// Seconds since the marker was last seen; 0 when never.
    [[nodiscard]] double age_s(std::int64_t capture_ns) const;

    /// Takes in what was measured at an instant. A measurement that the past denies starts the track anew: the arm was
    /// set to another pose.
    void update(std::int64_t capture_ns, const Fix& fix);

  private:
    struct State {
        Vector6 mean;        ///< position, m; velocity, m/s
        Matrix6 covariance;  ///< of it
    };

    [[nodiscard]] static State ahead(const State& state, double seconds);

    std::optional<State> state_;
    std::int64_t seen_ns_ = 0;
};

}  // namespace armsight::vision
