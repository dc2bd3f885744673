#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "armsight/vision/camera.hpp"
#include "armsight/vision/classify.hpp"
#include "armsight/vision/frame.hpp"
#include "armsight/vision/pool.hpp"

namespace armsight::vision {

/// Where a marker's outline is expected, in image coordinates (pixel centres at + 0.5).
struct Disc {
    Eigen::Vector2d centre;
    double radius;  ///< pixels
};

/// The outline of a sphere (world frame, metres); of radius 0 where its centre is behind the camera.
[[nodiscard]] Disc disc_of(const Camera& camera, const Eigen::Vector3d& position, double radius_m);

/// A point of an outline.
struct EdgePoint {
    Eigen::Vector3d ray;       ///< unit, optical frame
    double pixels_per_radian;  ///< what an angle there is worth in the image
};

/// Between two unit vectors, from the chord c alone: the angle is 2 asin(c / 2), exact to 1e-7 rad up to 0.6; a sphere
/// whose outline is wider than that fills the picture. Several times faster than the trigonometry, which is most of
/// what a fit does.
struct Opening {
    double angle;     ///< rad
    double cosine;    ///< of the angle
    double per_sine;  ///< 1 / sine; large, not infinite, at 0

    Opening(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
        const double c2 = (a - b).squaredNorm();
        const double c = std::sqrt(std::max(c2, 1e-18));
        angle = c * (1.0 + c2 * (1.0 / 24.0 + c2 * (3.0 / 640.0 + c2 * (5.0 / 7168.0))));
        cosine = 1.0 - 0.5 * c2;
        // sine = c sqrt(1 - c^2 / 4)
        per_sine = (1.0 + c2 * (1.0 / 8.0 + c2 * (3.0 / 128.0 + c2 * (5.0 / 1024.0)))) / c;
    }
};

/// How far an edge point lies outside of the outline that a cone of rays draws, pixels.
[[nodiscard]] inline double residual_px(const EdgePoint& point, const Eigen::Vector3d& axis, double half_angle) {
    return (Opening(point.ray, axis).angle - half_angle) * point.pixels_per_radian;
}

/// Outline of one marker in one image.
struct Outline {
    PoolVector<EdgePoint> points;                        ///< only where the marker meets a bright, neutral background
    std::int64_t area = 0;                               ///< pixels of the marker's colour within the disc
    Eigen::Vector2d centroid = Eigen::Vector2d::Zero();  ///< of these pixels, image coordinates
};

/// Which patches and which rows and columns a marker covers. Kept by the caller: no frame allocates them anew.
struct EdgeScratch {
    struct Extent {
        int first, last;  ///< pixels, inclusive; empty when first > last
    };
    std::vector<bool> belongs;          ///< by component of the mask
    std::vector<Extent> rows, columns;  ///< of the marker's bounding box, from its first row and column
};

/// Two colours unmixed: pixel = foreground * fg + background * bg, least squares over the channels.
struct Mix {
    double foreground, background;
};

/// Unmixes pixels of the same two colours.
class Unmixing {
  public:
    /// Nothing where the two are too much alike.
    [[nodiscard]] static std::optional<Unmixing> of(const Eigen::Vector3d& foreground,
                                                    const Eigen::Vector3d& background);

    [[nodiscard]] Mix operator()(const Eigen::Vector3d& pixel) const {
        return {.foreground = foreground_.dot(pixel), .background = background_.dot(pixel)};
    }

  private:
    Unmixing(Eigen::Vector3d foreground, Eigen::Vector3d background)
        : foreground_(std::move(foreground)), background_(std::move(background)) {}

    Eigen::Vector3d foreground_, background_;  // what a pixel is multiplied by for its share of each
};

/// Which ends of rows and columns are measured.
enum class Outlined : std::uint8_t {
    Round,     ///< rows where the expected disc's outline is steep, columns where it is shallow
    Sparse,    ///< the same, every third of them: tells roughly where the outline is
    Straight,  ///< those that differ from both neighbours' by a pixel at most
};

/// Sub-pixel outline of a marker: the ends of each row where the outline is steep, of each column where it is shallow.
/// The edge is where the coverage, summed over the mixed pixels, says; a shading of the marker cancels. Ends that meet
/// something dark or coloured (a link, another marker) are left out: they are the occluder's edge, not the sphere's.
void find_edges(const ImageView& image, const Camera& camera, const ColorCone& cone, const MarkerMask& mask,
                const Disc& expected, EdgeScratch& scratch, Outline& outline, Outlined shape = Outlined::Round);

}  // namespace armsight::vision
