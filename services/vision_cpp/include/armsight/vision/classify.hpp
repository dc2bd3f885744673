#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "armsight/vision/description.hpp"
#include "armsight/vision/frame.hpp"

namespace armsight::vision {

/// A marker's colours: a cone in RGB space with its tip at black, bounded by planes, so that brightness cancels.
/// Chromaticity (RGB divided by its sum) is compared without dividing: every test is a sum of products.
/// The numbers are small enough for 16-bit vectors: |coefficients| of a plane add up to at most 128.
struct ColorCone {
    using Plane = std::array<std::int16_t, 3>;

    Plane hue;         ///< direction of the colour away from grey
    int floor;         ///< least chroma along `hue`: below it sensor noise decides, not colour
    Plane saturation;  ///< not negative where the colour is pure enough; excludes grey, whatever its brightness
    Plane left;        ///< not negative on this side of the hue's lower bound
    Plane right;       ///< not negative on this side of the hue's upper bound
    int neutral;       ///< no pixel whose channels differ by this or less is inside

    /// What |coefficients| add up to before they are rounded: (126 + 3 / 2) * 255 < 2^15.
    static constexpr int kUnit = 126;

    [[nodiscard]] bool contains(int red, int green, int blue) const {
        const auto dot = [=](const Plane& p) { return p[0] * red + p[1] * green + p[2] * blue; };
        return dot(hue) >= floor && dot(saturation) >= 0 && dot(left) >= 0 && dot(right) >= 0;
    }
};

/// How far from a marker's own colour its pixels may be.
struct ColorThresholds {
    /// Chroma (distance from the grey axis) below which noise decides, in grey levels: 3.5 times a sensor noise of 4.
    double chroma_floor = 14.0;
    /// Share of the marker's own saturation that a pixel must have. Mixed pixels at an outline keep it while the marker
    /// covers most of them; the sub-pixel edge is found by unmixing later.
    double saturation_share = 0.3;
    /// Half width of a hue: 2.4 standard deviations of the hue of a marker as dark as 40 grey levels at noise 4, and
    /// narrower than half of the 60 degrees between red and yellow, so that orange is neither.
    double hue_half_width_deg = 20.0;

    friend bool operator==(const ColorThresholds&, const ColorThresholds&) = default;
};

/// One cone for each marker. They don't overlap: between neighbouring hues the bisector decides.
/// Throws std::invalid_argument when a marker is grey or two have nearly the same hue.
[[nodiscard]] std::vector<ColorCone> color_cones(std::span<const MarkerModel> markers,
                                                 const ColorThresholds& thresholds = {});

/// Pixels x0 <= x < x1 of row y that belong to one marker.
struct Run {
    int y, x0, x1;
    int component;  ///< index into MarkerMask::components once these are found

    friend bool operator==(const Run&, const Run&) = default;
};

/// Connected pixels of one marker's colour.
struct Component {
    std::int64_t area;          ///< pixels
    std::int64_t sum_x, sum_y;  ///< of pixel indices
    int x0, y0, x1, y1;         ///< bounds, half open

    friend bool operator==(const Component&, const Component&) = default;

    /// Centroid in image coordinates (pixel centres at + 0.5).
    [[nodiscard]] Eigen::Vector2d centroid() const {
        return {static_cast<double>(sum_x) / static_cast<double>(area) + 0.5,
                static_cast<double>(sum_y) / static_cast<double>(area) + 0.5};
    }
};

/// Where one marker's colour is in one image. Keeps its memory from frame to frame.
struct MarkerMask {
    std::vector<Run> runs;              ///< by row, then column
    std::vector<Component> components;  ///< in the order of their first runs
};

/// Runs kept for one marker: a picture of nothing but noise must not take all memory. A real marker has one a row.
inline constexpr std::size_t kMaxRuns = 131'072;

/// Fills one mask for each cone, in one pass over the pixels: background, links and base have no chroma and are left
/// out. Sizes `masks` as the cones.
void classify(const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks);

/// classify() or another one that does the same.
using Classifier = std::function<void(const ImageView&, std::span<const ColorCone>, std::vector<MarkerMask>&)>;

}  // namespace armsight::vision
