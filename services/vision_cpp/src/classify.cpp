#include "armsight/vision/classify.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <stdexcept>

#include "scan.hpp"

namespace armsight::vision {
namespace {

constexpr double kMinHueDistance = 12.0 * std::numbers::pi / 180.0;
constexpr double kMinSaturation = 0.15;  // of a marker's colour: chroma divided by the sum of its channels

struct Hue {
    Eigen::Vector3d direction;  // unit, perpendicular to grey
    double saturation;          // chroma / sum
    double angle;
};

Hue hue_of(const MarkerModel& marker) {
    const double sum = marker.color.sum();
    const Eigen::Vector3d chroma = marker.color - Eigen::Vector3d::Constant(sum / 3.0);
    const double norm = chroma.norm();
    if (!marker.color.allFinite() || !(sum > 0.0) || marker.color.minCoeff() < 0.0 || !(norm > kMinSaturation * sum)) {
        throw std::invalid_argument("marker '" + marker.name +
                                    "' has no colour of its own: cameras cannot tell it from grey");
    }
    const Eigen::Vector3d first = Eigen::Vector3d(2.0, -1.0, -1.0).normalized();
    const Eigen::Vector3d second = Eigen::Vector3d(0.0, 1.0, -1.0).normalized();
    return {chroma / norm, norm / sum, std::atan2(chroma.dot(second), chroma.dot(first))};
}

double angle_between(double a, double b) { return std::abs(std::remainder(a - b, 2.0 * std::numbers::pi)); }

// The same plane with coefficients that fit, and what one unit of the normal's length has become.
struct Scaled {
    ColorCone::Plane plane;
    double scale;
};

Scaled scaled(const Eigen::Vector3d& normal) {
    const double scale = ColorCone::kUnit / normal.lpNorm<1>();
    const auto unit = [&](int i) { return static_cast<std::int16_t>(std::lround(normal[i] * scale)); };
    return {.plane = {unit(0), unit(1), unit(2)}, .scale = scale};
}

// A pixel whose largest channel is `difference` above its least one, level l, gives hue . (l + differences): no more
// than the level's part, which is rounding, and the positive coefficients' times the difference.
int neutral_difference(const ColorCone::Plane& hue, int floor) {
    int sum = 0;
    int positive = 0;
    for (const int coefficient : hue) {
        sum += coefficient;
        positive += std::max(coefficient, 0);
    }
    const int of_level = std::max(sum, 0) * 255;
    return std::clamp((floor - 1 - of_level) / std::max(positive, 1), 0, 255);
}

int root_of(std::vector<Run>& runs, int run) {
    // `component` holds the parent run until components are numbered; path halving keeps it short
    const auto parent = [&](int i) -> int& { return runs[static_cast<std::size_t>(i)].component; };
    while (parent(run) != run) {
        parent(run) = parent(parent(run));
        run = parent(run);
    }
    return run;
}

// Joins runs that touch, diagonally too, and numbers the groups by size.
void find_components(MarkerMask& mask) {
    auto& runs = mask.runs;
    mask.components.clear();
    const int count = static_cast<int>(runs.size());
    for (int i = 0; i < count; ++i) runs[static_cast<std::size_t>(i)].component = i;
    int above = 0;
    for (int i = 0; i < count; ++i) {
        const Run run = runs[static_cast<std::size_t>(i)];
        const auto ends_before = [&](const Run& other) {
            return other.y < run.y - 1 || (other.y == run.y - 1 && other.x1 < run.x0);
        };
        while (above < i && ends_before(runs[static_cast<std::size_t>(above)])) ++above;
        for (int j = above; j < i; ++j) {
            const Run& other = runs[static_cast<std::size_t>(j)];
            if (other.y != run.y - 1 || other.x0 > run.x1) break;
            const int a = root_of(runs, i);
            const int b = root_of(runs, j);
            runs[static_cast<std::size_t>(std::max(a, b))].component = std::min(a, b);
        }
    }
    // roots come before their members, so each run's parent is numbered already: store numbers as -1 - number
    for (int i = 0; i < count; ++i) {
        Run& run = runs[static_cast<std::size_t>(i)];
        int number = 0;
        if (run.component == i) {
            number = static_cast<int>(mask.components.size());
            mask.components.push_back(
                {.area = 0, .sum_x = 0, .sum_y = 0, .x0 = run.x0, .y0 = run.y, .x1 = run.x1, .y1 = run.y + 1});
        } else {
            number = -1 - runs[static_cast<std::size_t>(run.component)].component;
        }
        run.component = -1 - number;
        Component& component = mask.components[static_cast<std::size_t>(number)];
        const std::int64_t n = run.x1 - run.x0;
        component.area += n;
        component.sum_x += n * (run.x0 + run.x1 - 1) / 2;
        component.sum_y += n * run.y;
        component.x0 = std::min(component.x0, run.x0);
        component.x1 = std::max(component.x1, run.x1);
        component.y1 = run.y + 1;
    }
    for (Run& run : runs) run.component = -1 - run.component;
}

}  // namespace

std::vector<ColorCone> color_cones(std::span<const MarkerModel> markers, const ColorThresholds& thresholds) {
    std::vector<Hue> hues;
    hues.reserve(markers.size());
    for (const MarkerModel& marker : markers) hues.push_back(hue_of(marker));

    const Eigen::Vector3d grey = Eigen::Vector3d::Constant(1.0 / std::sqrt(3.0));
    std::vector<ColorCone> cones;
    cones.reserve(markers.size());
    for (std::size_t i = 0; i < hues.size(); ++i) {
        double half_width = thresholds.hue_half_width_deg * std::numbers::pi / 180.0;
        for (std::size_t j = 0; j < hues.size(); ++j) {
            if (i == j) continue;
            const double distance = angle_between(hues[i].angle, hues[j].angle);
            if (distance < kMinHueDistance) {
                throw std::invalid_argument("markers '" + markers[i].name + "' and '" + markers[j].name +
                                            "' have nearly the same hue: cameras cannot tell them apart");
            }
            half_width = std::min(half_width, distance / 2.0);
        }
        const Eigen::Vector3d& h = hues[i].direction;
        const Eigen::Vector3d across = grey.cross(h);
        const double s = std::sin(half_width);
        const double c = std::cos(half_width);
        const Scaled hue = scaled(h);
        const int floor = static_cast<int>(std::lround(thresholds.chroma_floor * hue.scale));
        cones.push_back(
            {.hue = hue.plane,
             .floor = floor,
             .saturation =
                 scaled(h - Eigen::Vector3d::Constant(thresholds.saturation_share * hues[i].saturation)).plane,
             .left = scaled(s * h + c * across).plane,
             .right = scaled(s * h - c * across).plane,
             .neutral = neutral_difference(hue.plane, floor)});
    }
    return cones;
}

void classify(const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks) {
    masks.resize(cones.size());
    for (MarkerMask& mask : masks) mask.runs.clear();
    scan(image, cones, masks);
    for (MarkerMask& mask : masks) find_components(mask);
}

}  // namespace armsight::vision
