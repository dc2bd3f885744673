#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
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
    /// World frame, metres; of one that stays there whatever the arm does
    std::optional<Eigen::Vector3d> fixed = std::nullopt;

    friend bool operator==(const MarkerModel&, const MarkerModel&) = default;
};

}  // namespace armsight::vision
