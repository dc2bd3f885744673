#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <string_view>

#include "armsight/vision/pool.hpp"

namespace armsight::vision {

/// What one camera saw of one marker; pixels of the wire (integer = pixel centre).
struct Observation {
    std::string_view camera;              ///< the Camera's own name: not longer than it
    double u, v;                          ///< projected centre of the sphere (not the centroid of its image)
    double radius_px;                     ///< of its outline; of a disc as large as it, where it is none
    double area_px;                       ///< pixels in its mask
    double visible;                       ///< share of its outline's area, 0 to 1
    PoolVector<Eigen::Vector2d> corners;  ///< of a box's outline, in order; only when asked for
    PoolVector<Eigen::Vector2d> inliers;  ///< edge points that the position rests on; only when asked for
};

enum class MarkerStatus {
    Tracked,         ///< outline seen by two views or more
    PartlyOccluded,  ///< two views or more, part of the outline hidden in at least one
    OneView,         ///< one view: its ray, the known radius and the last state; see the covariance
    Lost,            ///< seen by none: the last state, carried on for a moment
};

struct MarkerEstimate {
    std::string name;
    MarkerStatus status = MarkerStatus::Lost;
    std::optional<Eigen::Vector3d> position;  ///< world frame, metres; nothing when never seen
    Eigen::Matrix3d covariance;               ///< m^2
    std::optional<Eigen::Vector3d> extent;    ///< of a box along the axes of the world, metres
    double age_s = 0.0;                       ///< since any camera saw it; 0 when never seen
    PoolVector<Observation> observations;

    /// Nothing seen, nothing known; the name stays.
    void set_lost(double seconds_since_seen) {
        status = MarkerStatus::Lost;
        position.reset();
        covariance.setZero();
        extent.reset();
        age_s = seconds_since_seen;
        observations.clear();
    }
};

}  // namespace armsight::vision
