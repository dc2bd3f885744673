#include "armsight/vision/pipeline.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>

#include "armsight/vision/cone.hpp"
#include "armsight/vision/edges.hpp"
#include "armsight/vision/track.hpp"
#include "armsight/vision/triangulate.hpp"
#include "box_finder.hpp"
#include "search.hpp"

namespace armsight::vision {
namespace {

// Smaller patches are sensor noise and speckle, not a marker that can be measured.
constexpr std::int64_t kMinAreaPx = 12;
// Less of the disc than this in view: its middle is anywhere in the disc.
constexpr double kMinVisible = 0.02;
// Below this share a part of the outline is certainly hidden; rasterisation alone takes about 2 %.
constexpr double kWholeVisible = 0.95;
// A view whose edge points do not lie on the fitted outline saw something else.
constexpr double kAgreementPx = 1.0;
constexpr double kMinAgreement = 0.4;
// Where a box has the same colour: of a box as wide as the sphere 0.4 of the edge points lie on the sphere's outline.
constexpr double kMinAgreementShared = 0.7;
// From here on nothing better is looked for: outlines without an occluder give nearly 1.
constexpr double kSureAgreement = 0.8;
// Middle of a mask without a usable outline, in radii: exact but for shading where all of the disc is seen, nearly a
// radius off where only a sliver of it is.
constexpr double kCentreSigmaSeen = 0.05;
constexpr double kCentreSigmaHidden = 0.8;
constexpr int kMinInliersTracked = 8;
constexpr double kMinCentreSigmaPx = 1.0;
// Told from a box of the same colour: a circle at most this much larger than the patch, and this share of its points.
constexpr double kMaxRoundness = 1.5;
constexpr double kMinRoundShare = 0.4;
constexpr std::size_t kFew = 8;
// A marker is looked for this far around where it is expected: what its outline is searched in, and this many standard
// deviations; unless the regions together are a good part of the picture.
constexpr double kReach = 1.7;  // radii
constexpr double kDoubt = 3.0;
constexpr double kMarginPx = 4.0;
constexpr double kMinReachPx = 33.0;  // what is narrower than a vector is read pixel by pixel
constexpr double kMaxShare = 0.3;
// A disc this near to where the outline was searched: a search there finds the same to a hundredth of that.
constexpr double kSamePlacePx = 0.5;
// One view agrees with the last state within this many standard deviations, or the last state is dropped (a reset).
constexpr double kMaxPriorDistance = 4.0;

const Component* largest(const MarkerMask& mask) {
    const auto found = std::ranges::max_element(mask.components, {}, &Component::area);
    return found == mask.components.end() || found->area < kMinAreaPx ? nullptr : &*found;
}

// In a picture of speckle there are thousands, and each costs a fit.
PoolVector<const Component*> largest_few(const MarkerMask& mask) {
    PoolVector<const Component*> result;
    for (const Component& component : mask.components) {
        if (component.area >= kMinAreaPx) result.push_back(&component);
    }
    const auto few = std::min(result.size(), kFew);
    const auto middle = result.begin() + static_cast<std::ptrdiff_t>(few);
    std::ranges::partial_sort(result, middle, std::ranges::greater{}, &Component::area);
    result.resize(few);
    return result;
}

// What one camera sees of one marker, on the way from mask to measurement.
struct Sighting {
    std::size_t frame;
    Outline outline;
    std::optional<Cone> cone;
    Disc disc;               ///< the sphere's outline as far as known
    Eigen::Vector3d centre;  ///< unit ray to the middle of the disc, optical frame
    bool has_outline = false;
};

Sighting sighting_of(std::size_t frame, const Component& component) {
    // of a part of the disc: its extent is nearer to the truth than its area
    const double extent = 0.5 * std::max(component.x1 - component.x0, component.y1 - component.y0);
    const double from_area = std::sqrt(static_cast<double>(component.area) / std::numbers::pi);
    return {.frame = frame,
            .outline = {},
            .cone = std::nullopt,
            .disc = {.centre = component.centroid(), .radius = std::max(extent, from_area)},
            .centre = {}};
}

// One answer to where a marker is, and how far the views agree with it.
using Sightings = PoolVector<Sighting>;

struct Attempt {
    Fix fix;
    Sightings sightings;  ///< of an attempt that is kept
    std::size_t views;
    std::size_t worst;  ///< view that agrees least
    double agreement;   ///< of that view, 0 to 1
    double needed;      ///< of agreement, for the answer to count
    double surprise;    ///< m from the last state; 0 without one

    [[nodiscard]] bool is_agreed() const { return agreement >= needed; }
};

bool is_better(const Attempt& a, const Attempt& b) {
    if (a.is_agreed() != b.is_agreed()) return a.is_agreed();
    if (a.views != b.views) return a.views > b.views;
    if (a.surprise != b.surprise) return a.surprise < b.surprise;
    return a.fix.inliers > b.fix.inliers;
}

Disc disc_of(const Camera& camera, const Cone& cone, const Disc& otherwise) {
    const auto centre = project(camera, cone.axis);
    if (!centre) return otherwise;
    return {.centre = *centre, .radius = cone.half_angle * pixels_per_radian(camera, cone.axis)};
}

Ray world_ray(const Camera& camera, const Eigen::Vector3d& direction) {
    return {.origin = camera.T_world_camera.translation(), .direction = camera.T_world_camera.linear() * direction};
}

}  // namespace

bool is_measurable(const CameraFrame& frame) {
    return frame.camera != nullptr && is_usable(*frame.camera) && frame.camera->width == frame.image.width &&
           frame.camera->height == frame.image.height;
}

struct Pipeline::State {
    Classifier classifier;
    std::vector<MarkerModel> markers;
    std::vector<ColorCone> cones;                // one a colour
    std::vector<std::size_t> color_of;           // by marker: which of the cones is its own
    std::vector<bool> is_shared;                 // by marker: whether a body of another shape has its colour
    std::vector<Track> tracks;                   // of spheres
    std::map<std::size_t, BoxFinder> boxes;      // by marker
    std::vector<std::vector<MarkerMask>> masks;  // by frame, then colour
    Sightings sightings;
    std::vector<CameraFrame> frames;
    std::vector<MarkerMask> one_mask;  // scratch
    std::vector<bool> is_sure;         // by marker: found where the middles of its patches meet
    bool is_partial = false;           // whether masks are of a part of the frames only
    EdgeScratch scratch;
    bool outlines_shown = false;
    std::optional<std::int64_t> answered_ns;
    std::size_t answered_frames = 0;
    std::vector<MarkerEstimate> answer;

    [[nodiscard]] bool classify_expected(std::int64_t capture_ns);
    void classify_all();
    void look(std::size_t marker);
    void look_for_largest(std::size_t marker);
    void look_for_round(std::size_t marker);
    void look_closely(std::size_t marker);
    void refine(std::size_t marker, const Eigen::Vector3d& position, Outlined shape = Outlined::Round);
    [[nodiscard]] bool is_where_searched(std::size_t marker, const Eigen::Vector3d& position) const;
    [[nodiscard]] PoolVector<Ray> rays() const;
    [[nodiscard]] PoolVector<View> views() const;
    [[nodiscard]] PoolVector<Eigen::Vector3d> starts(std::size_t marker, std::int64_t capture_ns) const;
    [[nodiscard]] std::optional<Fix> fit(std::size_t marker, const Eigen::Vector3d& start, std::int64_t capture_ns);
    [[nodiscard]] std::optional<Attempt> settle(std::size_t marker, const Eigen::Vector3d& position,
                                                std::int64_t capture_ns);
    [[nodiscard]] std::optional<Attempt> at_once(std::size_t marker, std::int64_t capture_ns);
    [[nodiscard]] std::optional<Attempt> best_of(std::size_t marker, const Sightings& seen, std::int64_t capture_ns);
    [[nodiscard]] std::optional<Attempt> without_one(std::size_t marker, const Sightings& seen,
                                                     std::int64_t capture_ns);
    [[nodiscard]] std::optional<Fix> locate(std::size_t marker, std::int64_t capture_ns);
    [[nodiscard]] Observation observe(const Sighting& sighting, double radius_m, const Eigen::Vector3d& position) const;
    void estimate(std::size_t marker, std::int64_t capture_ns);
    [[nodiscard]] PoolVector<SameColoredSphere> seen_spheres(std::size_t color) const;
    [[nodiscard]] const MarkerMask& mask(std::size_t frame, std::size_t marker) const {
        return masks[frame][color_of[marker]];
    }
    [[nodiscard]] const ColorCone& cone(std::size_t marker) const { return cones[color_of[marker]]; }
};

// Where each marker is expected, when all of them were certain at the last instant. Returns false where a search
// there would cost as much as one everywhere, or where what is found does not end there.
bool Pipeline::State::classify_expected(std::int64_t capture_ns) {
    if (!boxes.empty() || std::ranges::find(is_sure, false) != is_sure.end()) return false;
    bool is_whole = true;
    for (std::size_t i = 0; i < frames.size() && is_whole; ++i) {
        const CameraFrame& frame = frames[i];
        masks[i].resize(cones.size());
        double pixels = 0.0;
        for (std::size_t marker = 0; marker < markers.size() && is_whole; ++marker) {
            const auto expected = tracks[marker].predict(capture_ns);
            if (!expected) return false;
            const double radius = markers[marker].radius;
            const Disc disc = disc_of(*frame.camera, expected->position, radius);
            const double doubt = kDoubt * std::sqrt(expected->covariance.trace()) * disc.radius / radius;
            const double reach = std::max(kReach * disc.radius + doubt + kMarginPx, kMinReachPx);
            const Region region = region_around(frame.image, disc, reach);
            pixels += static_cast<double>(region.x1 - region.x0) * (region.y1 - region.y0);
            if (pixels > kMaxShare * frame.image.width * frame.image.height) return false;
            is_whole =
                classify_region(classifier, frame.image, cone(marker), region, masks[i][color_of[marker]], one_mask);
        }
    }
    return is_whole;
}

void Pipeline::State::classify_all() {
    for (std::size_t i = 0; i < frames.size(); ++i) classifier(frames[i].image, cones, masks[i]);
    is_partial = false;
}

// First look: in each frame the patch that is most likely the marker.
void Pipeline::State::look(std::size_t marker) {
    if (is_shared[marker]) {
        look_for_round(marker);
    } else {
        look_for_largest(marker);
    }
}

void Pipeline::State::look_for_largest(std::size_t marker) {
    sightings.clear();
    for (std::size_t i = 0; i < frames.size(); ++i) {
        const Component* component = largest(mask(i, marker));
        if (component == nullptr) continue;
        Sighting sighting = sighting_of(i, *component);
        sighting.centre = ray(*frames[i].camera, sighting.disc.centre.x(), sighting.disc.centre.y());
        sightings.push_back(std::move(sighting));
    }
}

// Where a box has the same colour: in each frame the patch of which most edge points lie on one circle
// that is about as large as the patch. Straight edges lie on larger ones.
void Pipeline::State::look_for_round(std::size_t marker) {
    sightings.clear();
    for (std::size_t i = 0; i < frames.size(); ++i) {
        std::optional<Sighting> best;
        int most = 0;
        for (const Component* component : largest_few(mask(i, marker))) {
            Sighting sighting = sighting_of(i, *component);
            find_edges(frames[i].image, *frames[i].camera, cone(marker), mask(i, marker), sighting.disc, scratch,
                       sighting.outline);
            const auto cone = fit_cone(sighting.outline.points);
            if (!cone || cone->inliers <= most) continue;
            const Disc disc = disc_of(*frames[i].camera, *cone, sighting.disc);
            if (disc.radius > kMaxRoundness * sighting.disc.radius ||
                cone->inliers < kMinRoundShare * static_cast<double>(sighting.outline.points.size())) {
                continue;
            }
            most = cone->inliers;
            sighting.cone = cone;
            sighting.disc = disc;
            best = std::move(sighting);
        }
        if (!best) continue;
        best->centre = ray(*frames[i].camera, best->disc.centre.x(), best->disc.centre.y());
        sightings.push_back(std::move(*best));
    }
}

// A closer one: the cone through each patch's outline, without knowing what belongs to it.
void Pipeline::State::look_closely(std::size_t marker) {
    for (Sighting& sighting : sightings) {
        const CameraFrame& frame = frames[sighting.frame];
        for (int pass = 0; pass < 2; ++pass) {
            find_edges(frame.image, *frame.camera, cone(marker), mask(sighting.frame, marker), sighting.disc, scratch,
                       sighting.outline);
            const auto cone = fit_cone(sighting.outline.points);
            sighting.cone = cone;
            if (!cone) break;
            sighting.disc = disc_of(*frame.camera, *cone, sighting.disc);
        }
        sighting.centre = ray(*frame.camera, sighting.disc.centre.x(), sighting.disc.centre.y());
        sighting.has_outline = sighting.cone.has_value();
    }
}

// Second look: where the sphere is known to be, its parts on both sides of an occluder belong together.
void Pipeline::State::refine(std::size_t marker, const Eigen::Vector3d& position, Outlined shape) {
    for (Sighting& sighting : sightings) {
        const CameraFrame& frame = frames[sighting.frame];
        sighting.disc = disc_of(*frame.camera, position, markers[marker].radius);
        find_edges(frame.image, *frame.camera, cone(marker), mask(sighting.frame, marker), sighting.disc, scratch,
                   sighting.outline, shape);
        sighting.cone.reset();
        sighting.has_outline = sighting.outline.points.size() >= static_cast<std::size_t>(kMinInliersTracked) / 2;
        sighting.centre = ray(*frame.camera, sighting.outline.centroid.x(), sighting.outline.centroid.y());
    }
    const auto is_hidden = [](const Sighting& s) {
        return static_cast<double>(s.outline.area) < kMinVisible * std::numbers::pi * s.disc.radius * s.disc.radius ||
               s.outline.area < kMinAreaPx;
    };
    std::erase_if(sightings, is_hidden);
}

// Through the middles of all sightings.
PoolVector<Ray> Pipeline::State::rays() const {
    PoolVector<Ray> result;
    result.reserve(sightings.size());
    for (const Sighting& s : sightings) result.push_back(world_ray(*frames[s.frame].camera, s.centre));
    return result;
}

PoolVector<View> Pipeline::State::views() const {
    PoolVector<View> result;
    result.reserve(sightings.size());
    for (const Sighting& sighting : sightings) {
        const double radius = sighting.disc.radius;
        const double seen = static_cast<double>(sighting.outline.area) / (std::numbers::pi * radius * radius);
        const double hidden = 1.0 - std::clamp(seen, 0.0, 1.0);
        const double sigma = std::max(kMinCentreSigmaPx, (kCentreSigmaSeen + kCentreSigmaHidden * hidden) * radius);
        result.push_back(
            {.camera = frames[sighting.frame].camera,
             .outline = sighting.has_outline ? std::span<const EdgePoint>(sighting.outline.points)
                                             : std::span<const EdgePoint>(),
             .centre = sighting.centre,
             .centre_sigma_px = sighting.has_outline ? 0.0 : sigma,
             .centre_pixels_per_radian = pixels_per_radian(*frames[sighting.frame].camera, sighting.centre)});
    }
    return result;
}

// Where to start the fit: where the rays of all views meet, and where each view alone puts the sphere. A view of which
// an edge was mistaken for the sphere's outline spoils the first, but not what the others say by themselves.
PoolVector<Eigen::Vector3d> Pipeline::State::starts(std::size_t marker, std::int64_t capture_ns) const {
    PoolVector<Eigen::Vector3d> result;
    const auto towards = rays();
    if (const auto point = triangulate(towards)) result.push_back(*point);
    for (std::size_t i = 0; i < sightings.size(); ++i) {
        const auto& cone = sightings[i].cone;
        if (!cone) continue;
        const Ray& ray = towards[i];
        result.emplace_back(ray.origin + markers[marker].radius / std::sin(cone->half_angle) * ray.direction);
    }
    if (const auto prior = tracks[marker].predict(capture_ns); prior && result.empty() && !towards.empty()) {
        const Ray& ray = towards.front();
        const double along = std::max(ray.direction.dot(prior->position - ray.origin), 2.0 * markers[marker].radius);
        result.emplace_back(ray.origin + along * ray.direction);
    }
    return result;
}

std::optional<Fix> Pipeline::State::fit(std::size_t marker, const Eigen::Vector3d& start, std::int64_t capture_ns) {
    const double radius = markers[marker].radius;
    if (sightings.size() >= 2) return fit_sphere(views(), radius, start);
    const auto prior = tracks[marker].predict(capture_ns);
    auto alone = sightings.front().has_outline ? fit_sphere(views(), radius, start) : std::nullopt;
    // a box may look round from one side: one view that the past does not confirm says nothing then
    std::optional<Fix> unconfirmed = is_shared[marker] ? std::nullopt : alone;
    if (!prior) return unconfirmed;
    if (alone) {
        const Eigen::Vector3d apart = alone->position - prior->position;
        const Eigen::Matrix3d covariance = alone->covariance + prior->covariance;
        if (apart.dot(covariance.inverse() * apart) > kMaxPriorDistance * kMaxPriorDistance) return unconfirmed;
    }
    const auto together = fit_sphere(views(), radius, start, prior);
    return together ? together : alone;
}

Observation Pipeline::State::observe(const Sighting& sighting, double radius_m, const Eigen::Vector3d& position) const {
    const Camera& camera = *frames[sighting.frame].camera;
    const Disc disc = disc_of(camera, position, radius_m);
    const Eigen::Vector3d c = camera.T_world_camera.inverse() * position;
    const Cone joint{.axis = c.normalized(),
                     .half_angle = std::asin(std::min(1.0, radius_m / c.norm())),
                     .inliers = 0,
                     .residual_px = 0.0};
    const auto own = refine_cone(sighting.outline.points, joint);
    const auto seen = own ? project(camera, own->axis) : std::nullopt;
    const Eigen::Vector2d centre = seen.value_or(sighting.outline.centroid);
    const auto area = static_cast<double>(sighting.outline.area);
    const double whole = std::numbers::pi * std::max(disc.radius * disc.radius, 1.0);
    Observation result{.camera = camera.name,
                       .u = centre.x() - kWireToImage,
                       .v = centre.y() - kWireToImage,
                       .radius_px = disc.radius,
                       .area_px = area,
                       .visible = std::clamp(area / whole, 0.0, 1.0),
                       .corners = {},
                       .inliers = {}};
    for (const EdgePoint& point : sighting.outline.points) {
        if (!outlines_shown || std::abs(residual_px(point, joint.axis, joint.half_angle)) > kAgreementPx) continue;
        if (const auto pixel = wire_pixel(camera, point.ray)) result.inliers.push_back(*pixel);
    }
    return result;
}

// Looks where the marker would be, fits, and tells how far each view agrees with what comes out.
std::optional<Attempt> Pipeline::State::settle(std::size_t marker, const Eigen::Vector3d& position,
                                               std::int64_t capture_ns) {
    refine(marker, position);
    if (sightings.empty()) return std::nullopt;
    const auto fix = fit(marker, position, capture_ns);
    if (!fix) return std::nullopt;
    const auto prior = tracks[marker].predict(capture_ns);
    Attempt result{.fix = *fix,
                   .sightings = {},
                   .views = sightings.size(),
                   .worst = 0,
                   .agreement = 1.0,
                   .needed = is_shared[marker] ? kMinAgreementShared : kMinAgreement,
                   .surprise = prior ? (fix->position - prior->position).norm() : 0.0};
    const auto all = views();
    for (std::size_t i = 0; i < all.size(); ++i) {
        if (all[i].outline.empty()) continue;
        const double share = agreement(all[i], markers[marker].radius, fix->position, kAgreementPx);
        if (share < result.agreement) {
            result.agreement = share;
            result.worst = i;
        }
    }
    return result;
}

// Where the last refine() searched, as far as the outline depends on it.
bool Pipeline::State::is_where_searched(std::size_t marker, const Eigen::Vector3d& position) const {
    return std::ranges::all_of(sightings, [&](const Sighting& s) {
        const Disc disc = disc_of(*frames[s.frame].camera, position, markers[marker].radius);
        return (disc.centre - s.disc.centre).norm() < kSamePlacePx &&
               std::abs(disc.radius - s.disc.radius) < kSamePlacePx;
    });
}

// The usual case, and the quick one: where the middles of all patches meet, the sphere's outline is seen in all views.
// What was known before is not asked: the answer is the same whether patches were looked for there or everywhere.
std::optional<Attempt> Pipeline::State::at_once(std::size_t marker, std::int64_t capture_ns) {
    const std::size_t views_seen = sightings.size();
    const auto middle = triangulate(rays());
    if (!middle) return std::nullopt;
    refine(marker, *middle, Outlined::Sparse);
    if (sightings.size() < views_seen) return std::nullopt;
    const auto start = rough_sphere(views(), markers[marker].radius, *middle);
    if (!start) return std::nullopt;
    auto result = settle(marker, *start, capture_ns);
    if (result && result->views == views_seen && !is_where_searched(marker, result->fix.position)) {
        result = settle(marker, result->fix.position, capture_ns);
    }
    if (!result || result->agreement < kSureAgreement || result->views < views_seen) return std::nullopt;
    return result;
}

// From every start, once with all that was seen at first and once with what is seen at the start itself: a larger patch
// of the colour hides the marker from the first look, not from the second.
std::optional<Attempt> Pipeline::State::best_of(std::size_t marker, const Sightings& seen, std::int64_t capture_ns) {
    sightings = seen;
    std::optional<Attempt> best;
    for (const Eigen::Vector3d& start : starts(marker, capture_ns)) {
        for (const bool is_here : {false, true}) {
            sightings = seen;
            if (is_here) refine(marker, start);
            if (sightings.empty()) continue;
            const auto rough = fit(marker, start, capture_ns);
            if (!rough) continue;
            auto next = settle(marker, rough->position, capture_ns);
            if (next && (!best || is_better(*next, *best))) {
                best = std::move(next);
                best->sightings = sightings;
            }
            if (best && best->is_agreed() && best->views == seen.size()) return best;
        }
    }
    return best;
}

std::optional<Attempt> Pipeline::State::without_one(std::size_t marker, const Sightings& seen,
                                                    std::int64_t capture_ns) {
    std::optional<Attempt> best;
    for (std::size_t left_out = 0; left_out < seen.size(); ++left_out) {
        Sightings others = seen;
        others.erase(others.begin() + static_cast<std::ptrdiff_t>(left_out));
        auto next = best_of(marker, others, capture_ns);
        if (next && (!best || is_better(*next, *best))) best = std::move(next);
    }
    return best;
}

// Leaves the sightings that belong to the answer.
std::optional<Fix> Pipeline::State::locate(std::size_t marker, std::int64_t capture_ns) {
    look(marker);
    Sightings seen = sightings;
    auto sure = at_once(marker, capture_ns);
    if (!sure && is_partial) {
        classify_all();
        look(marker);
        seen = sightings;
        sure = at_once(marker, capture_ns);
    }
    is_sure[marker] = sure.has_value();
    if (sure) return sure->fix;
    sightings = seen;
    look_closely(marker);
    seen = sightings;
    while (!seen.empty()) {
        auto best = best_of(marker, seen, capture_ns);
        if (!best || !best->is_agreed()) {
            // one view, or more of them, saw something else
            auto fewer = without_one(marker, seen, capture_ns);
            if (fewer && (!best || is_better(*fewer, *best))) best = std::move(fewer);
        }
        if (!best) break;
        sightings = std::move(best->sightings);
        if (best->is_agreed()) return best->fix;
        sightings.erase(sightings.begin() + static_cast<std::ptrdiff_t>(best->worst));
        seen = sightings;
    }
    sightings.clear();
    return std::nullopt;
}

void Pipeline::State::estimate(std::size_t marker, std::int64_t capture_ns) {
    const MarkerModel& model = markers[marker];
    MarkerEstimate& result = answer[marker];
    Track& track = tracks[marker];
    const std::optional<Fix> fix = locate(marker, capture_ns);
    result.set_lost(track.age_s(capture_ns));
    if (fix) {
        bool whole = true;
        for (const Sighting& sighting : sightings) {
            result.observations.push_back(observe(sighting, model.radius, fix->position));
            whole = whole && sighting.has_outline && result.observations.back().visible >= kWholeVisible;
        }
        if (sightings.size() < 2 || fix->inliers < kMinInliersTracked) {
            result.status = MarkerStatus::OneView;
        } else {
            result.status = whole ? MarkerStatus::Tracked : MarkerStatus::PartlyOccluded;
        }
        result.position = fix->position;
        result.covariance = fix->covariance;
        result.age_s = 0.0;
        track.update(capture_ns, *fix);
    } else if (const auto prior = track.predict(capture_ns)) {
        result.position = prior->position;
        result.covariance = prior->covariance;
    }
}

PoolVector<SameColoredSphere> Pipeline::State::seen_spheres(std::size_t color) const {
    PoolVector<SameColoredSphere> result;
    for (std::size_t i = 0; i < markers.size(); ++i) {
        if (color_of[i] != color || markers[i].shape != Shape::Sphere) continue;
        const auto& position = answer[i].position;
        if (position && answer[i].status != MarkerStatus::Lost) result.push_back({*position, markers[i].radius});
    }
    return result;
}

Pipeline::Pipeline(std::vector<MarkerModel> markers, Classifier classifier, const ColorThresholds& thresholds)
    : state_(std::make_unique<State>()) {
    state_->classifier = std::move(classifier);
    std::vector<MarkerModel> palette;  // one marker of each colour
    for (const MarkerModel& marker : markers) {
        const auto is_twin = [&](const MarkerModel& m) { return m.color == marker.color && m.shape == marker.shape; };
        // of two with the same shape, color_cones() says that they cannot be told apart
        const bool is_ambiguous = std::ranges::count_if(markers, is_twin) > 1;
        const auto same = is_ambiguous ? palette.end() : std::ranges::find(palette, marker.color, &MarkerModel::color);
        state_->color_of.push_back(static_cast<std::size_t>(same - palette.begin()));
        if (same == palette.end()) palette.push_back(marker);
    }
    state_->cones = color_cones(palette, thresholds);
    for (std::size_t i = 0; i < markers.size(); ++i) {
        const std::size_t color = state_->color_of[i];
        state_->is_shared.push_back(std::ranges::count(state_->color_of, color) > 1);
        if (markers[i].shape == Shape::Box) state_->boxes.emplace(i, BoxFinder(color));
    }
    state_->tracks.resize(markers.size());
    state_->is_sure.resize(markers.size());
    state_->answer.resize(markers.size());
    for (std::size_t i = 0; i < markers.size(); ++i) state_->answer[i].name = markers[i].name;
    state_->markers = std::move(markers);
}

Pipeline::~Pipeline() = default;
Pipeline::Pipeline(Pipeline&&) noexcept = default;
Pipeline& Pipeline::operator=(Pipeline&&) noexcept = default;

const std::vector<MarkerEstimate>& Pipeline::process(std::int64_t capture_ns, std::span<const CameraFrame> frames) {
    State& state = *state_;
    if (state.answered_ns == capture_ns && state.answered_frames == frames.size()) return state.answer;
    if (state.answered_ns && capture_ns < *state.answered_ns) reset();  // another run: its past is not this one's

    state.frames.clear();
    std::ranges::copy_if(frames, std::back_inserter(state.frames), is_measurable);
    state.masks.resize(state.frames.size());
    state.is_partial = state.classify_expected(capture_ns);
    if (!state.is_partial) state.classify_all();

    for (std::size_t i = 0; i < state.markers.size(); ++i) {
        if (!state.boxes.contains(i)) state.estimate(i, capture_ns);
    }
    // what is a sphere's is not a box's
    for (auto& [i, box] : state.boxes) {
        const std::size_t color = state.color_of[i];
        box.find(capture_ns, state.frames, state.masks, state.cones[color], state.seen_spheres(color), state.answer[i]);
        if (!state.outlines_shown) continue;
        for (Observation& observation : state.answer[i].observations) box.show_outline(observation);
    }
    state.answered_ns = capture_ns;
    state.answered_frames = frames.size();
    return state.answer;
}

void Pipeline::show_outlines(bool shown) { state_->outlines_shown = shown; }

void Pipeline::reset() {
    std::ranges::fill(state_->tracks, Track{});
    state_->is_sure.assign(state_->is_sure.size(), false);
    for (auto& [marker, box] : state_->boxes) box.reset();
    state_->answered_ns.reset();
}

}  // namespace armsight::vision
