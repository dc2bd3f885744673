#include "box_finder.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "armsight/vision/triangulate.hpp"

namespace armsight::vision {
namespace {

constexpr std::int64_t kMinAreaPx = 12;  // as for spheres
constexpr std::size_t kMinPoints = 12;   // two a number
// A patch whose middle lies in the sphere's disc and that is no larger than it is the sphere.
constexpr double kSphereArea = 1.2;
// Edge points this near to the sphere's outline are taken for the sphere's.
constexpr double kSphereBand = 1.5;
// A sphere, or a sphere and a box together, leave most points off any box's outline.
constexpr double kAgreementPx = 1.0;
constexpr double kMinAgreement = 0.85;
// Squared distance in standard deviations of two extents that are one body's.
constexpr double kSameExtent = 30.0;

bool is_of(const Component& component, const Disc& sphere) {
    const double disc = std::numbers::pi * sphere.radius * sphere.radius;
    return (component.centroid() - sphere.centre).norm() < sphere.radius &&
           static_cast<double>(component.area) < kSphereArea * disc;
}

// True when the component holds the middle of the disc or a point half-way to its border.
bool contains(const MarkerMask& mask, int component, const Disc& disc) {
    const auto holds = [&](double dx, double dy) {
        const int x = static_cast<int>(std::floor(disc.centre.x() + dx * disc.radius));
        const int y = static_cast<int>(std::floor(disc.centre.y() + dy * disc.radius));
        return std::ranges::any_of(mask.runs, [&](const Run& run) {
            return run.component == component && run.y == y && run.x0 <= x && x < run.x1;
        });
    };
    constexpr double kHalf = 0.5;
    return holds(0.0, 0.0) || holds(kHalf, 0.0) || holds(-kHalf, 0.0) || holds(0.0, kHalf) || holds(0.0, -kHalf);
}

std::optional<Eigen::Vector2d> pixel_of(const Camera& camera, const Eigen::Vector3d& position) {
    return project(camera, camera.T_world_camera.inverse() * position);
}

}  // namespace

void BoxFinder::reset() {
    track_ = Track{};
    extent_.reset();
}

// The largest patch of the colour in each frame that is not the sphere's, and its edges.
void BoxFinder::look(const Scene& scene) {
    sightings_.clear();
    for (std::size_t i = 0; i < scene.frames.size(); ++i) {
        const Camera& camera = *scene.frames[i].camera;
        const Component* largest = nullptr;
        for (const Component& component : scene.masks[i][cone_index_].components) {
            const bool is_sphere = std::ranges::any_of(
                scene.spheres, [&](const auto& s) { return is_of(component, disc_of(camera, s.position, s.radius)); });
            if (is_sphere || component.area < kMinAreaPx) continue;
            if (largest == nullptr || component.area > largest->area) largest = &component;
        }
        if (largest == nullptr) continue;
        const MarkerMask& mask = scene.masks[i][cone_index_];
        const auto number = static_cast<int>(largest - mask.components.data());
        const double extent = 0.5 * std::max(largest->x1 - largest->x0, largest->y1 - largest->y0);
        Sighting sighting{.frame = &scene.frames[i],
                          .outline = {},
                          .around = {.centre = largest->centroid(), .radius = extent},
                          .is_merged = std::ranges::any_of(scene.spheres, [&](const auto& s) {
                              return contains(mask, number, disc_of(camera, s.position, s.radius));
                          })};
        find_own_edges(scene, sighting);
        if (sighting.outline.points.size() >= kMinPoints) sightings_.push_back(std::move(sighting));
    }
}

// Those near the outline of a sphere of the same colour are left out.
void BoxFinder::find_own_edges(const Scene& scene, Sighting& sighting) {
    const Camera& camera = *sighting.frame->camera;
    const auto index = static_cast<std::size_t>(sighting.frame - scene.frames.data());
    find_edges(sighting.frame->image, camera, scene.cone, scene.masks[index][cone_index_], sighting.around, scratch_,
               sighting.outline, Outlined::Straight);
    for (const SameColoredSphere& sphere : scene.spheres) {
        const Eigen::Vector3d at = camera.T_world_camera.inverse() * sphere.position;
        const double half_angle = std::asin(std::min(1.0, sphere.radius / at.norm()));
        std::erase_if(sighting.outline.points, [&](const EdgePoint& point) {
            return std::abs(residual_px(point, at.normalized(), half_angle)) < kSphereBand;
        });
    }
}

// Its extent, and its place where the views do not tell it.
std::optional<BoxPrior> BoxFinder::prior(std::int64_t capture_ns) const {
    const auto where = track_.predict(capture_ns);
    if (!where || !extent_) return std::nullopt;
    BoxPrior result{.box = {.centre = where->position, .half = extent_->half}, .information = Matrix6::Zero()};
    result.information.bottomRightCorner<3, 3>() = extent_->covariance.inverse();
    if (is_one_sided()) result.information.topLeftCorner<3, 3>() = where->covariance.inverse();
    return result;
}

// Where the middles of the outlines meet, as wide as they are.
std::optional<Box> BoxFinder::start(std::int64_t capture_ns) const {
    PoolVector<Ray> rays;
    for (const Sighting& sighting : sightings_) {
        Eigen::Vector3d middle = Eigen::Vector3d::Zero();
        for (const EdgePoint& point : sighting.outline.points) middle += point.ray;
        const Eigen::Isometry3d& pose = sighting.frame->camera->T_world_camera;
        rays.push_back({.origin = pose.translation(), .direction = pose.linear() * middle.normalized()});
    }
    const auto middle = triangulate(rays);
    if (!middle) {
        const auto known = prior(capture_ns);
        return known ? std::optional(known->box) : std::nullopt;
    }
    double half = 0.0;
    for (const Sighting& sighting : sightings_) {
        const Camera& camera = *sighting.frame->camera;
        const double distance = (*middle - camera.T_world_camera.translation()).norm();
        half = std::max(half, sighting.around.radius * distance / camera.K(0, 0));
    }
    return Box{.centre = *middle, .half = Eigen::Vector3d::Constant(0.7 * half)};
}

// Then the place is not determined by what is seen: where box and sphere make one patch, a side lies within it.
bool BoxFinder::is_one_sided() const {
    return sightings_.size() < 2 || std::ranges::any_of(sightings_, &Sighting::is_merged);
}

PoolVector<BoxView> BoxFinder::views() const {
    PoolVector<BoxView> result;
    result.reserve(sightings_.size());
    for (const Sighting& s : sightings_) result.push_back({.camera = s.frame->camera, .outline = s.outline.points});
    return result;
}

// Without what was known where nothing is hidden, else with it.
std::optional<BoxFinder::Finding> BoxFinder::settle(const Box& from, std::int64_t capture_ns) const {
    const auto known = prior(capture_ns);
    if (!is_one_sided()) {
        const auto free = fit_box(views(), from);
        if (free && is_agreed(free->box) && is_outlined(free->box)) return Finding{.fix = *free, .whole = true};
    }
    if (!known) return std::nullopt;
    // a hidden side may be the left or the right one: from the middle of what is seen the wrong one may be found
    for (const Box& start : {from, known->box}) {
        const auto fix = fit_box(views(), start, known);
        if (fix && is_agreed(fix->box)) return Finding{.fix = *fix, .whole = false};
    }
    return std::nullopt;
}

std::optional<BoxFinder::Finding> BoxFinder::locate(const Scene& scene) {
    const auto from = start(scene.capture_ns);
    if (!from) return std::nullopt;
    const auto rough = fit_box(views(), *from, prior(scene.capture_ns));
    if (!rough) return std::nullopt;
    const auto first = settle(rough->box, scene.capture_ns);
    // around the box itself now, not around a patch that a sphere may be part of
    const Box& box = first ? first->fix.box : rough->box;
    for (Sighting& sighting : sightings_) {
        const auto outline = silhouette(*sighting.frame->camera, box);
        const auto middle = pixel_of(*sighting.frame->camera, box.centre);
        if (!outline || !middle) return std::nullopt;
        sighting.around.centre = *middle;
        if (!sighting.is_merged) sighting.around.radius = outline->radius_px();
        find_own_edges(scene, sighting);
    }
    const auto second = settle(box, scene.capture_ns);
    return second ? second : first;
}

bool BoxFinder::is_outlined(const Box& box) const {
    const auto all = views();
    return std::ranges::all_of(all, [&](const BoxView& v) { return vision::is_outlined(v, box, kAgreementPx); });
}

bool BoxFinder::is_agreed(const Box& box) const {
    return std::ranges::all_of(sightings_, [&](const Sighting& s) {
        return agreement({.camera = s.frame->camera, .outline = s.outline.points}, box, kAgreementPx) >= kMinAgreement;
    });
}

void BoxFinder::find(std::int64_t capture_ns, std::span<const CameraFrame> frames,
                     std::span<const std::vector<MarkerMask>> masks, const ColorCone& cone,
                     std::span<const SameColoredSphere> spheres, MarkerEstimate& result) {
    result.set_lost(track_.age_s(capture_ns));
    const Scene scene{.capture_ns = capture_ns, .frames = frames, .masks = masks, .cone = cone, .spheres = spheres};
    look(scene);
    const auto found = locate(scene);
    if (!found) {
        const auto known = track_.predict(capture_ns);
        if (known && extent_) {
            result.position = known->position;
            result.covariance = known->covariance;
            result.extent = 2.0 * extent_->half;
        }
        return;
    }
    const Box& box = found->fix.box;
    found_ = box;
    for (const Sighting& sighting : sightings_) {
        const Camera& camera = *sighting.frame->camera;
        const auto outline = silhouette(camera, box);
        const auto middle = pixel_of(camera, box.centre);
        if (!outline || !middle) continue;
        const double area = outline->area_px();
        const auto seen = static_cast<double>(sighting.outline.area);
        result.observations.push_back({.camera = camera.name,
                                       .u = middle->x() - kWireToImage,
                                       .v = middle->y() - kWireToImage,
                                       .radius_px = std::sqrt(area / std::numbers::pi),
                                       .area_px = seen,
                                       .visible = std::clamp(seen / std::max(area, 1.0), 0.0, 1.0),
                                       .corners = {},
                                       .inliers = {}});
    }
    if (sightings_.size() < 2) {
        result.status = MarkerStatus::OneView;
    } else {
        result.status = found->whole ? MarkerStatus::Tracked : MarkerStatus::PartlyOccluded;
    }
    result.position = box.centre;
    result.covariance = found->fix.covariance.topLeftCorner<3, 3>();
    result.extent = 2.0 * box.half;
    result.age_s = 0.0;
    track_.update(capture_ns, {.position = *result.position,
                               .covariance = result.covariance,
                               .sigma_px = found->fix.sigma_px,
                               .inliers = found->fix.inliers,
                               .has_prior = is_one_sided()});
    if (found->whole) remember(box, found->fix.covariance.bottomRightCorner<3, 3>());
}

void BoxFinder::show_outline(Observation& observation) const {
    for (const Sighting& sighting : sightings_) {
        const Camera& camera = *sighting.frame->camera;
        const auto outline = silhouette(camera, found_);
        if (camera.name != observation.camera || !outline) continue;
        for (std::size_t i = 0; i < outline->count; ++i) {
            if (const auto pixel = wire_pixel(camera, outline->ray_of(i))) observation.corners.push_back(*pixel);
        }
        for (const EdgePoint& point : sighting.outline.points) {
            if (agreement({.camera = &camera, .outline = {&point, 1}}, found_, kAgreementPx) < 1.0) continue;
            if (const auto pixel = wire_pixel(camera, point.ray)) observation.inliers.push_back(*pixel);
        }
    }
}

// The best known one; another box's where the two contradict each other.
void BoxFinder::remember(const Box& box, const Eigen::Matrix3d& covariance) {
    if (extent_ && extent_->covariance.trace() <= covariance.trace()) {
        const Eigen::Vector3d apart = box.half - extent_->half;
        const Eigen::Matrix3d both = covariance + extent_->covariance;
        if (apart.dot(both.inverse() * apart) < kSameExtent) return;
    }
    extent_ = {.half = box.half, .covariance = covariance};
}

}  // namespace armsight::vision
