#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>

#include "armsight/vision/triangulate.hpp"

namespace armsight::vision {

/// What is remembered of one marker between instants: for the instants at which one camera or none sees it.
class Track {
  public:
    /// The last position with a covariance that has grown since; nothing when never seen.
    [[nodiscard]] std::optional<Prior> predict(std::int64_t capture_ns) const;

    /// Seconds since the marker was last seen; 0 when never.
    [[nodiscard]] double age_s(std::int64_t capture_ns) const;

    /// Remembers what was measured at an instant.
    void update(std::int64_t capture_ns, const Eigen::Vector3d& position, const Eigen::Matrix3d& covariance);

  private:
    std::optional<Prior> last_;
    std::int64_t seen_ns_ = 0;
};

}  // namespace armsight::vision
