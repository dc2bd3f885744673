#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "armsight/vision/camera.hpp"
#include "armsight/vision/description.hpp"
#include "armsight/vision/frame.hpp"

namespace armsight::vision::testing {

struct Sphere {
    Eigen::Vector3d centre;  ///< world frame, metres
    double radius;
    Eigen::Vector3d color;  ///< 0 to 1
};

/// A link: black, with round ends.
struct Capsule {
    Eigen::Vector3d start, end;
    double radius;
};

/// Its sides along the axes of the world.
struct Cuboid {
    Eigen::Vector3d centre, half;
    Eigen::Vector3d color;
};

struct Scene {
    std::vector<Sphere> spheres;
    std::vector<Cuboid> cuboids = {};
    std::vector<Capsule> capsules;
    double background = 0.7;  ///< grey, 0 to 1
};

/// An image that owns its bytes.
struct Picture {
    std::vector<std::uint8_t> bytes;
    int width, height, step;
    PixelFormat format;
    [[nodiscard]] ImageView view() const {
        return {.data = bytes, .width = width, .height = height, .step = step, .format = format};
    }
};

/// Draws by casting `oversampling` x `oversampling` rays a pixel through the camera's pinhole: exact spheres, real
/// occlusion, simple shading. Shares nothing with the code under test but the camera's data.
Picture draw(const Scene& scene, const Camera& camera, int oversampling = 4);

/// The same picture with Gaussian noise on every channel.
Picture with_noise(Picture picture, double sigma, unsigned seed);

/// The same picture in another order of channels, with padding bytes after each row.
Picture converted(const Picture& picture, PixelFormat format, int padding);

/// The arm's two cameras: 800 x 800, 80 degrees, 18 m away, 6 m up.
Camera front_camera(int size = 800);
Camera side_camera(int size = 800);

/// A camera at `eye` that looks at `target`, z up.
Camera camera_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target, int width, int height, double focal);

/// Green, yellow, blue, red with the arm's radii.
std::vector<MarkerModel> arm_markers();

}  // namespace armsight::vision::testing
