#pragma once

#include <Eigen/Core>
#include <string>

namespace armsight::vision {

/// A coloured sphere to look for.
struct MarkerModel {
    std::string name;
    double radius;          ///< metres
    Eigen::Vector3d color;  ///< linear RGB, 0 to 1; only its chromaticity matters
};

}  // namespace armsight::vision
