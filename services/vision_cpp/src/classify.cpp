#include "armsight/vision/classify.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <stdexcept>

namespace armsight::vision {
namespace {

// Chroma (distance from the grey axis) below which noise decides: 3.5 times a sensor noise of 4 grey levels.
constexpr double kChromaFloor = 14.0;
// Share of the marker's own saturation that a pixel must have. Mixed pixels at an outline keep it while the marker
// covers most of them; the sub-pixel edge is found by unmixing later.
constexpr double kSaturationShare = 0.3;
// Half width of a hue: 2.4 standard deviations of the hue of a marker as dark as 40 grey levels at noise 4, and
// narrower than half of the 60 degrees between red and yellow, so that orange is neither.
constexpr double kHueHalfWidth = 20.0 * std::numbers::pi / 180.0;
constexpr double kMinHueDistance = 12.0 * std::numbers::pi / 180.0;
constexpr double kMinSaturation = 0.15;  // of a marker's colour: chroma divided by the sum of its channels

// |R - G| and |G - B| of a pixel whose chroma reaches the floor cannot both be this small:
// chroma^2 = ((R-G)^2 + (G-B)^2 + (B-R)^2) / 3 <= 2 t^2 = 162 < 14^2.
constexpr int kNeutralDifference = 9;
constexpr int kBlock = 32;  // pixels that are skipped together

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

ColorCone::Plane plane(const Eigen::Vector3d& normal) {
    const auto unit = [&](int i) { return static_cast<int>(std::lround(normal[i] * ColorCone::kUnit)); };
    return {unit(0), unit(1), unit(2)};
}

// True when no pixel of a full block can have chroma above the floor. Compares neighbouring bytes, so that compilers
// turn it into wide byte instructions; differences across pixels are masked out.
template <int PixelSize>
bool block_is_neutral(const std::uint8_t* p) {
    constexpr auto kMask = [] {
        std::array<std::uint8_t, static_cast<std::size_t>(kBlock * PixelSize)> mask{};
        for (std::size_t i = 0; i < mask.size(); ++i) mask[i] = i % PixelSize < 2 ? 255 : 0;
        return mask;
    }();
    std::uint8_t largest = 0;
    for (std::size_t i = 0; i + 1 < kMask.size(); ++i) {
        const std::uint8_t high = std::max(p[i], p[i + 1]);
        const std::uint8_t low = std::min(p[i], p[i + 1]);
        const auto difference = static_cast<std::uint8_t>(static_cast<unsigned>(high - low) & kMask[i]);
        largest = std::max(largest, difference);
    }
    return largest <= kNeutralDifference;
}

class Scanner {
  public:
    Scanner(const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks)
        : image_(image), cones_(cones), masks_(masks), layout_(layout(image.format)) {}

    template <int PixelSize>
    void scan() {
        for (int y = 0; y < image_.height; ++y) {
            const std::uint8_t* row = image_.row(y);
            int x = 0;
            for (; x + kBlock <= image_.width; x += kBlock) {
                if (!block_is_neutral<PixelSize>(row + std::ptrdiff_t{x} * PixelSize))
                    scan_pixels<PixelSize>(row, y, x, x + kBlock);
            }
            scan_pixels<PixelSize>(row, y, x, image_.width);
        }
    }

  private:
    template <int PixelSize>
    void scan_pixels(const std::uint8_t* row, int y, int begin, int end) {
        for (int x = begin; x < end; ++x) {
            const std::uint8_t* p = row + std::ptrdiff_t{x} * PixelSize;
            const int red = p[layout_.red];
            const int green = p[layout_.green];
            const int blue = p[layout_.blue];
            if (std::abs(red - green) <= kNeutralDifference && std::abs(green - blue) <= kNeutralDifference) continue;
            for (std::size_t i = 0; i < cones_.size(); ++i) {
                if (cones_[i].contains(red, green, blue)) {
                    append(masks_[i].runs, y, x);
                    break;
                }
            }
        }
    }

    static void append(std::vector<Run>& runs, int y, int x) {
        if (!runs.empty() && runs.back().y == y && runs.back().x1 == x) {
            ++runs.back().x1;
        } else if (runs.size() < kMaxRuns) {
            runs.push_back({.y = y, .x0 = x, .x1 = x + 1, .component = -1});
        }
    }

    const ImageView& image_;
    std::span<const ColorCone> cones_;
    std::vector<MarkerMask>& masks_;
    PixelLayout layout_;
};

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

std::vector<ColorCone> color_cones(std::span<const MarkerModel> markers) {
    std::vector<Hue> hues;
    hues.reserve(markers.size());
    for (const MarkerModel& marker : markers) hues.push_back(hue_of(marker));

    const Eigen::Vector3d grey = Eigen::Vector3d::Constant(1.0 / std::sqrt(3.0));
    std::vector<ColorCone> cones;
    cones.reserve(markers.size());
    for (std::size_t i = 0; i < hues.size(); ++i) {
        double half_width = kHueHalfWidth;
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
        cones.push_back({.hue = plane(h),
                         .floor = static_cast<int>(std::lround(kChromaFloor * ColorCone::kUnit)),
                         .saturation = plane(h - Eigen::Vector3d::Constant(kSaturationShare * hues[i].saturation)),
                         .left = plane(s * h + c * across),
                         .right = plane(s * h - c * across)});
    }
    return cones;
}

void classify(const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks) {
    masks.resize(cones.size());
    for (MarkerMask& mask : masks) mask.runs.clear();
    Scanner scanner(image, cones, masks);
    if (layout(image.format).size == 4) {
        scanner.scan<4>();
    } else {
        scanner.scan<3>();
    }
    for (MarkerMask& mask : masks) find_components(mask);
}

}  // namespace armsight::vision
