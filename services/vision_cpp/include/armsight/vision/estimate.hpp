#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

namespace armsight::vision {

/// What one camera saw of one marker; pixels of the wire (integer = pixel centre).
struct Observation {
    std::string camera;
    double u, v;       ///< projected centre of the sphere (not the centroid of its image)
    double radius_px;  ///< of its outline
    double area_px;    ///< pixels in its mask
    double visible;    ///< share of its disc, 0 to 1
};

enum class MarkerStatus {
    Tracked,         ///< outline seen by two views or more
    PartlyOccluded,  ///< two views or more, part of the outline hidden in at least one
    OneView,         ///< one view: its ray, the known radius and the last state; see the covariance
    Lost,            ///< seen by none: the last state, carried on for a moment
};

struct MarkerEstimate {
    std::string name;
    MarkerStatus status;
    std::optional<Eigen::Vector3d> position;  ///< world frame, metres; nothing when never seen
    Eigen::Matrix3d covariance;               ///< m^2
    double age_s;                             ///< since any camera saw it; 0 when never seen
    std::vector<Observation> observations;
};

}  // namespace armsight::vision
