#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>

namespace armsight::vision {

enum class Shape : std::uint8_t {
    Sphere,
    Box,  ///< its sides along the axes of the world
};

/// A coloured body to look for.
struct MarkerModel {
    std::string name;
    double radius;          ///< metres; of a sphere, unused for a box, whose extent is measured
    Eigen::Vector3d color;  ///< linear RGB, 0 to 1; only its chromaticity matters
    Shape shape = Shape::Sphere;

    friend bool operator==(const MarkerModel&, const MarkerModel&) = default;
};

}  // namespace armsight::vision
