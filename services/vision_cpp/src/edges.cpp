#include "armsight/vision/edges.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <span>

namespace armsight::vision {
namespace {

// Components count when they reach into the expected disc, which may be off by a good part of its radius (occlusion).
constexpr double kReach = 1.6;  // radii
// Smaller ones are sensor noise on dark pixels.
constexpr std::int64_t kMinComponentArea = 6;
// Background: brighter than links, nearly grey, and even, so that no other edge lies in it.
constexpr double kMinBackground = 40.0;         // grey levels
constexpr double kBackgroundChroma = 0.2;       // (max - min) / max, plus kNoise
constexpr double kBackgroundUnevenness = 0.08;  // relative change from one pixel to the next, plus kNoise
constexpr double kNoise = 12.0;                 // grey levels: 3 standard deviations of a noisy sensor
// A mixed pixel with less foreground than this for its coverage, and kNoise, is darkened by a third thing: an occluder.
constexpr double kMinBrightness = 0.5;
// The innermost pixel must be covered and the outermost free, or the edge is not between them.
constexpr double kCoverageTolerance = 0.3;
constexpr int kSparse = 3;                  // every so many rows and columns tell roughly where a disc is
constexpr double kMaxCurvatureShift = 0.1;  // pixels; more means that the disc is too small to be measured so

struct Direction {
    int dx, dy;
};

class EdgeFinder {
  public:
    EdgeFinder(const ImageView& image, const ColorCone& cone)
        : image_(image), cone_(cone), layout_(layout(image.format)) {}

    // Distance from the inner border of the pixel before (x, y) to the edge, along `outward`; (x, y) is the outermost
    // pixel of the marker's colour.
    [[nodiscard]] std::optional<double> distance(int x, int y, Direction outward) const {
        const auto at = [&](int k) { return pixel(x + k * outward.dx, y + k * outward.dy); };
        if (!inside(x - 3 * outward.dx, y - 3 * outward.dy) || !inside(x + 4 * outward.dx, y + 4 * outward.dy)) {
            return std::nullopt;
        }
        const Eigen::Vector3d near = at(-2);
        const Eigen::Vector3d deep = at(-3);
        if (!is_marker(near) || !is_marker(deep)) return std::nullopt;
        const Eigen::Vector3d foreground = 0.5 * (near + deep);

        const Eigen::Vector3d free = at(3);
        const Eigen::Vector3d beyond = at(4);
        const Eigen::Vector3d background = 0.5 * (free + beyond);
        const double brightest = background.maxCoeff();
        if (background.minCoeff() < kMinBackground ||
            brightest - background.minCoeff() > kBackgroundChroma * brightest + kNoise ||
            (free - beyond).cwiseAbs().maxCoeff() > kBackgroundUnevenness * brightest + kNoise) {
            return std::nullopt;
        }
        const auto unmixing = Unmixing::of(foreground, background);
        if (!unmixing) return std::nullopt;
        const double doubt = kNoise / foreground.maxCoeff();
        double sum = 0.0;
        for (int k = -1; k <= 2; ++k) {
            const Eigen::Vector3d between = at(k);
            const Mix mix = (*unmixing)(between);
            if (!is_mix(between, mix, foreground, background)) return std::nullopt;
            const double coverage = 1.0 - mix.background;
            if (mix.foreground < kMinBrightness * coverage - doubt) return std::nullopt;
            if (k == -1 && coverage < 1.0 - kCoverageTolerance) return std::nullopt;
            if (k == 2 && coverage > kCoverageTolerance) return std::nullopt;
            sum += coverage;
        }
        return sum;
    }

  private:
    // False where a third colour lies between marker and background, such as the rim of a marker behind this one.
    [[nodiscard]] static bool is_mix(const Eigen::Vector3d& pixel, const Mix& mix, const Eigen::Vector3d& foreground,
                                     const Eigen::Vector3d& background) {
        const Eigen::Vector3d rest = pixel - mix.foreground * foreground - mix.background * background;
        return mix.foreground * foreground.maxCoeff() > -kNoise && rest.cwiseAbs().maxCoeff() < kNoise;
    }

    [[nodiscard]] bool inside(int x, int y) const { return x >= 0 && y >= 0 && x < image_.width && y < image_.height; }

    [[nodiscard]] Eigen::Vector3d pixel(int x, int y) const {
        const std::uint8_t* p = image_.row(y) + std::ptrdiff_t{x} * layout_.size;
        return {static_cast<double>(p[layout_.red]), static_cast<double>(p[layout_.green]),
                static_cast<double>(p[layout_.blue])};
    }

    [[nodiscard]] bool is_marker(const Eigen::Vector3d& p) const {
        return cone_.contains(static_cast<int>(p.x()), static_cast<int>(p.y()), static_cast<int>(p.z()));
    }

    const ImageView& image_;
    const ColorCone& cone_;
    PixelLayout layout_;
};

bool reaches(const Component& component, const Disc& disc) {
    if (component.area < kMinComponentArea) return false;
    const Eigen::Vector2d nearest(
        std::clamp(disc.centre.x(), static_cast<double>(component.x0), static_cast<double>(component.x1)),
        std::clamp(disc.centre.y(), static_cast<double>(component.y0), static_cast<double>(component.y1)));
    return (nearest - disc.centre).norm() < disc.radius &&
           (component.centroid() - disc.centre).norm() < kReach * disc.radius;
}

// Bounds of what belongs to a marker; half open, empty at first.
struct Box {
    int x0 = std::numeric_limits<int>::max(), y0 = std::numeric_limits<int>::max();
    int x1 = 0, y1 = 0;

    void add(const Component& c) {
        x0 = std::min(x0, c.x0);
        y0 = std::min(y0, c.y0);
        x1 = std::max(x1, c.x1);
        y1 = std::max(y1, c.y1);
    }
};

// By pixels that come in order.
void extend(EdgeScratch::Extent& extent, int first, int last) {
    if (extent.first > extent.last) extent.first = first;
    extent.last = last;
}

Box collect(const MarkerMask& mask, const Disc& disc, EdgeScratch& scratch, Outline& outline) {
    Box box;
    outline.area = 0;
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    scratch.belongs.assign(mask.components.size(), false);
    for (std::size_t i = 0; i < mask.components.size(); ++i) {
        const Component& component = mask.components[i];
        if (!reaches(component, disc)) continue;
        scratch.belongs[i] = true;
        outline.area += component.area;
        sum += static_cast<double>(component.area) * component.centroid();
        box.add(component);
    }
    outline.centroid = outline.area > 0 ? Eigen::Vector2d(sum / static_cast<double>(outline.area)) : disc.centre;
    if (outline.area == 0) return {.x0 = 0, .y0 = 0};
    constexpr EdgeScratch::Extent kEmpty{.first = 1, .last = 0};
    scratch.rows.assign(static_cast<std::size_t>(box.y1 - box.y0), kEmpty);
    scratch.columns.assign(static_cast<std::size_t>(box.x1 - box.x0), kEmpty);
    const auto first = std::ranges::lower_bound(mask.runs, box.y0, {}, &Run::y);
    const auto last = std::ranges::lower_bound(first, mask.runs.end(), box.y1, {}, &Run::y);
    for (const Run& run : std::span(first, last)) {
        if (!scratch.belongs[static_cast<std::size_t>(run.component)]) continue;
        extend(scratch.rows[static_cast<std::size_t>(run.y - box.y0)], run.x0, run.x1 - 1);
        for (int x = run.x0; x < run.x1; ++x)
            extend(scratch.columns[static_cast<std::size_t>(x - box.x0)], run.y, run.y);
    }
    return box;
}

// True where the outline goes on by a pixel at most to both neighbours.
bool is_even(const std::vector<EdgeScratch::Extent>& extents, int i, int EdgeScratch::Extent::* which) {
    if (i == 0 || i + 1 >= std::ssize(extents)) return false;
    const auto at = [&](int k) -> const EdgeScratch::Extent& { return extents[static_cast<std::size_t>(k)]; };
    const auto continues = [&](int k) {
        return at(k).first <= at(k).last && std::abs(at(k).*which - at(i).*which) <= 1;
    };
    return continues(i - 1) && continues(i + 1);
}

}  // namespace

Disc disc_of(const Camera& camera, const Eigen::Vector3d& position, double radius_m) {
    const Eigen::Vector3d c = camera.T_world_camera.inverse() * position;
    const double distance = std::max(c.norm(), 1.001 * radius_m);
    const Eigen::Vector3d axis = c / distance;
    const auto centre = project(camera, axis);
    if (!centre) return {.centre = {0.0, 0.0}, .radius = 0.0};
    return {.centre = *centre, .radius = std::asin(radius_m / distance) * pixels_per_radian(camera, axis)};
}

std::optional<Unmixing> Unmixing::of(const Eigen::Vector3d& foreground, const Eigen::Vector3d& background) {
    const double ff = foreground.squaredNorm();
    const double bb = background.squaredNorm();
    const double fb = foreground.dot(background);
    const double determinant = ff * bb - fb * fb;
    if (!(determinant > 1e-3 * ff * bb)) return std::nullopt;  // colours within 2 degrees of each other
    return Unmixing((bb * foreground - fb * background) / determinant,
                    (ff * background - fb * foreground) / determinant);
}

void find_edges(const ImageView& image, const Camera& camera, const ColorCone& cone, const MarkerMask& mask,
                const Disc& expected, EdgeScratch& scratch, Outline& outline, Outlined shape) {
    outline.points.clear();
    const Box box = collect(mask, expected, scratch, outline);
    outline.points.reserve(2 * (scratch.rows.size() + scratch.columns.size()));
    const EdgeFinder finder(image, cone);
    const bool is_straight = shape == Outlined::Straight;
    const int step = shape == Outlined::Sparse ? kSparse : 1;

    // A row's coverage is the mean over its height; the outline's curvature puts that mean inside of the outline at
    // the middle of the row: x(y0) = mean + R^2 / (24 |dx|^3).
    const auto curvature_shift = [&](double across) {
        if (is_straight) return 0.0;
        const double r2 = expected.radius * expected.radius;
        return std::min(kMaxCurvatureShift, r2 / (24.0 * std::max(1.0, std::abs(across * across * across))));
    };
    const auto add = [&](double x, double y) {
        const Eigen::Vector3d direction = ray(camera, x, y);
        outline.points.push_back({.ray = direction, .pixels_per_radian = pixels_per_radian(camera, direction)});
    };
    const auto end = [&](int x, int y, Direction outward) {
        const double dx = x + 0.5 - expected.centre.x();
        const double dy = y + 0.5 - expected.centre.y();
        const bool steep = outward.dx != 0;
        // outward must lead away from the centre, and rows are for steep parts of the outline only
        const double along = steep ? dx * outward.dx : dy * outward.dy;
        const double across = steep ? dy : dx;
        const bool is_own = along > std::abs(across) || (steep && along == std::abs(across));
        if (!is_straight && !is_own) return;
        const auto found = finder.distance(x, y, outward);
        if (!found) return;
        // from the centre of pixel (x, y): its inner neighbour's inner border is 1.5 pixels back
        const double offset = *found - 1.5 + curvature_shift(along);
        add(x + 0.5 + offset * outward.dx, y + 0.5 + offset * outward.dy);
    };
    const auto is_wanted = [&](const std::vector<EdgeScratch::Extent>& extents, int i,
                               int EdgeScratch::Extent::* which) { return !is_straight || is_even(extents, i, which); };
    for (int y = box.y0 + step / 2; y < box.y1; y += step) {
        const auto [first, last] = scratch.rows[static_cast<std::size_t>(y - box.y0)];
        if (first > last) continue;
        if (is_wanted(scratch.rows, y - box.y0, &EdgeScratch::Extent::first)) end(first, y, {.dx = -1, .dy = 0});
        if (is_wanted(scratch.rows, y - box.y0, &EdgeScratch::Extent::last)) end(last, y, {.dx = 1, .dy = 0});
    }
    for (int x = box.x0 + step / 2; x < box.x1; x += step) {
        const auto [first, last] = scratch.columns[static_cast<std::size_t>(x - box.x0)];
        if (first > last) continue;
        if (is_wanted(scratch.columns, x - box.x0, &EdgeScratch::Extent::first)) end(x, first, {.dx = 0, .dy = -1});
        if (is_wanted(scratch.columns, x - box.x0, &EdgeScratch::Extent::last)) end(x, last, {.dx = 0, .dy = 1});
    }
}

}  // namespace armsight::vision
