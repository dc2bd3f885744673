#include "armsight/vision/pipeline.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "armsight/vision/cone.hpp"
#include "armsight/vision/edges.hpp"
#include "armsight/vision/track.hpp"
#include "armsight/vision/triangulate.hpp"

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
// From here on nothing better is looked for: outlines without an occluder give nearly 1.
constexpr double kSureAgreement = 0.8;
// Middle of a mask without a usable outline, in radii: exact but for shading where all of the disc is seen, nearly a
// radius off where only a sliver of it is.
constexpr double kCentreSigmaSeen = 0.05;
constexpr double kCentreSigmaHidden = 0.8;
constexpr int kMinInliersTracked = 8;
constexpr double kMinCentreSigmaPx = 1.0;
// One view agrees with the last state within this many standard deviations, or the last state is dropped (a reset).
constexpr double kMaxPriorDistance = 4.0;

const Component* largest(const MarkerMask& mask) {
    const auto found = std::ranges::max_element(mask.components, {}, &Component::area);
    return found == mask.components.end() || found->area < kMinAreaPx ? nullptr : &*found;
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

// One answer to where a marker is, and how far the views agree with it.
struct Attempt {
    Fix fix;
    std::vector<Sighting> sightings;
    std::size_t worst;  ///< view that agrees least
    double agreement;   ///< of that view, 0 to 1
    double surprise;    ///< m from the last state; 0 without one

    [[nodiscard]] bool is_agreed() const { return agreement >= kMinAgreement; }
};

bool is_better(const Attempt& a, const Attempt& b) {
    if (a.is_agreed() != b.is_agreed()) return a.is_agreed();
    if (a.sightings.size() != b.sightings.size()) return a.sightings.size() > b.sightings.size();
    if (a.surprise != b.surprise) return a.surprise < b.surprise;
    return a.fix.inliers > b.fix.inliers;
}

Disc disc_of(const Camera& camera, const Eigen::Vector3d& axis, double half_angle, const Disc& otherwise) {
    const auto centre = project(camera, axis);
    if (!centre) return otherwise;
    return {.centre = *centre, .radius = half_angle * pixels_per_radian(camera, axis)};
}

Disc disc_of(const Camera& camera, const Eigen::Vector3d& position, double radius_m) {
    const Eigen::Vector3d c = camera.T_world_camera.inverse() * position;
    const double distance = std::max(c.norm(), 1.001 * radius_m);
    return disc_of(camera, c / distance, std::asin(radius_m / distance), {.centre = {0.0, 0.0}, .radius = 0.0});
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
    std::vector<ColorCone> cones;
    std::vector<Track> tracks;
    std::vector<std::vector<MarkerMask>> masks;  // by frame, then marker
    std::vector<Sighting> sightings;
    std::vector<CameraFrame> frames;
    EdgeScratch scratch;
    std::optional<std::int64_t> answered_ns;
    std::size_t answered_frames = 0;
    std::vector<MarkerEstimate> answer;

    void look(std::size_t marker);
    void look_closely(std::size_t marker);
    void refine(std::size_t marker, const Eigen::Vector3d& position);
    [[nodiscard]] std::vector<View> views() const;
    [[nodiscard]] std::vector<Eigen::Vector3d> starts(std::size_t marker, std::int64_t capture_ns) const;
    [[nodiscard]] std::optional<Fix> fit(std::size_t marker, const Eigen::Vector3d& start, std::int64_t capture_ns);
    [[nodiscard]] std::optional<Attempt> settle(std::size_t marker, const Eigen::Vector3d& position,
                                                std::int64_t capture_ns);
    [[nodiscard]] std::optional<Attempt> at_once(std::size_t marker, std::int64_t capture_ns);
    [[nodiscard]] std::optional<Attempt> best_of(std::size_t marker, const std::vector<Sighting>& seen,
                                                 std::int64_t capture_ns);
    [[nodiscard]] std::optional<Attempt> without_one(std::size_t marker, const std::vector<Sighting>& seen,
                                                     std::int64_t capture_ns);
    [[nodiscard]] std::optional<Fix> locate(std::size_t marker, std::int64_t capture_ns);
    [[nodiscard]] Observation observe(const Sighting& sighting, double radius_m, const Eigen::Vector3d& position) const;
    [[nodiscard]] MarkerEstimate estimate(std::size_t marker, std::int64_t capture_ns);
};

// First look: the largest patch of the colour in each frame.
void Pipeline::State::look(std::size_t marker) {
    sightings.clear();
    for (std::size_t i = 0; i < frames.size(); ++i) {
        const Component* component = largest(masks[i][marker]);
        if (component == nullptr) continue;
        // of a part of the disc: its extent is nearer to the truth than its area
        const double extent = 0.5 * std::max(component->x1 - component->x0, component->y1 - component->y0);
        const double from_area = std::sqrt(static_cast<double>(component->area) / std::numbers::pi);
        Sighting sighting{.frame = i,
                          .outline = {},
                          .cone = std::nullopt,
                          .disc = {.centre = component->centroid(), .radius = std::max(extent, from_area)},
                          .centre = {}};
        sighting.centre = ray(*frames[i].camera, sighting.disc.centre.x(), sighting.disc.centre.y());
        sightings.push_back(std::move(sighting));
    }
}

// A closer one: the cone through each patch's outline, without knowing what belongs to it.
void Pipeline::State::look_closely(std::size_t marker) {
    for (Sighting& sighting : sightings) {
        const CameraFrame& frame = frames[sighting.frame];
        for (int pass = 0; pass < 2; ++pass) {
            find_edges(frame.image, *frame.camera, cones[marker], masks[sighting.frame][marker], sighting.disc, scratch,
                       sighting.outline);
            const auto cone = fit_cone(sighting.outline.points);
            sighting.cone = cone;
            if (!cone) break;
            sighting.disc = disc_of(*frame.camera, cone->axis, cone->half_angle, sighting.disc);
        }
        sighting.centre = ray(*frame.camera, sighting.disc.centre.x(), sighting.disc.centre.y());
        sighting.has_outline = sighting.cone.has_value();
    }
}

// Second look: where the sphere is known to be, its parts on both sides of an occluder belong together.
void Pipeline::State::refine(std::size_t marker, const Eigen::Vector3d& position) {
    for (Sighting& sighting : sightings) {
        const CameraFrame& frame = frames[sighting.frame];
        sighting.disc = disc_of(*frame.camera, position, markers[marker].radius);
        find_edges(frame.image, *frame.camera, cones[marker], masks[sighting.frame][marker], sighting.disc, scratch,
                   sighting.outline);
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

std::vector<View> Pipeline::State::views() const {
    std::vector<View> result;
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
std::vector<Eigen::Vector3d> Pipeline::State::starts(std::size_t marker, std::int64_t capture_ns) const {
    std::vector<Eigen::Vector3d> result;
    std::vector<Ray> rays;
    rays.reserve(sightings.size());
    for (const Sighting& s : sightings) rays.push_back(world_ray(*frames[s.frame].camera, s.centre));
    if (const auto point = triangulate(rays)) result.push_back(*point);
    for (std::size_t i = 0; i < sightings.size(); ++i) {
        const auto& cone = sightings[i].cone;
        if (!cone) continue;
        result.emplace_back(rays[i].origin + markers[marker].radius / std::sin(cone->half_angle) * rays[i].direction);
    }
    if (const auto prior = tracks[marker].predict(capture_ns); prior && result.empty() && !rays.empty()) {
        const Ray& ray = rays.front();
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
    if (!prior) return alone;
    if (alone) {
        const Eigen::Vector3d apart = alone->position - prior->position;
        const Eigen::Matrix3d covariance = alone->covariance + prior->covariance;
        if (apart.dot(covariance.inverse() * apart) > kMaxPriorDistance * kMaxPriorDistance) return alone;
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
    return {.camera = camera.name,
            .u = centre.x() - kWireToImage,
            .v = centre.y() - kWireToImage,
            .radius_px = disc.radius,
            .area_px = area,
            .visible = std::clamp(area / whole, 0.0, 1.0)};
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
                   .sightings = sightings,
                   .worst = 0,
                   .agreement = 1.0,
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

// The usual case, and the quick one: where the middles of all patches meet, the sphere's outline is seen in all views.
std::optional<Attempt> Pipeline::State::at_once(std::size_t marker, std::int64_t capture_ns) {
    const std::size_t views_seen = sightings.size();
    std::vector<Ray> rays;
    rays.reserve(views_seen);
    for (const Sighting& s : sightings) rays.push_back(world_ray(*frames[s.frame].camera, s.centre));
    const auto middle = triangulate(rays);
    if (!middle) return std::nullopt;
    auto rough = settle(marker, *middle, capture_ns);
    if (!rough || sightings.size() < views_seen) return std::nullopt;
    auto result = settle(marker, rough->fix.position, capture_ns);
    if (!result || result->agreement < kSureAgreement || sightings.size() < views_seen) return std::nullopt;
    return result;
}

// From every start, once with all that was seen at first and once with what is seen at the start itself: a larger patch
// of the colour hides the marker from the first look, not from the second.
std::optional<Attempt> Pipeline::State::best_of(std::size_t marker, const std::vector<Sighting>& seen,
                                                std::int64_t capture_ns) {
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
            if (next && (!best || is_better(*next, *best))) best = std::move(next);
            if (best && best->is_agreed() && best->sightings.size() == seen.size()) return best;
        }
    }
    return best;
}

std::optional<Attempt> Pipeline::State::without_one(std::size_t marker, const std::vector<Sighting>& seen,
                                                    std::int64_t capture_ns) {
    std::optional<Attempt> best;
    for (std::size_t left_out = 0; left_out < seen.size(); ++left_out) {
        std::vector<Sighting> others = seen;
        others.erase(others.begin() + static_cast<std::ptrdiff_t>(left_out));
        auto next = best_of(marker, others, capture_ns);
        if (next && (!best || is_better(*next, *best))) best = std::move(next);
    }
    return best;
}

// Leaves the sightings that belong to the answer.
std::optional<Fix> Pipeline::State::locate(std::size_t marker, std::int64_t capture_ns) {
    look(marker);
    std::vector<Sighting> seen = sightings;
    if (const auto sure = at_once(marker, capture_ns)) return sure->fix;
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

MarkerEstimate Pipeline::State::estimate(std::size_t marker, std::int64_t capture_ns) {
    const MarkerModel& model = markers[marker];
    Track& track = tracks[marker];
    const std::optional<Fix> fix = locate(marker, capture_ns);
    MarkerEstimate result{.name = model.name,
                          .status = MarkerStatus::Lost,
                          .position = std::nullopt,
                          .covariance = Eigen::Matrix3d::Zero(),
                          .age_s = track.age_s(capture_ns),
                          .observations = {}};
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
    return result;
}

Pipeline::Pipeline(std::vector<MarkerModel> markers, Classifier classifier) : state_(std::make_unique<State>()) {
    state_->classifier = std::move(classifier);
    state_->cones = color_cones(markers);
    state_->tracks.resize(markers.size());
    state_->markers = std::move(markers);
}

Pipeline::~Pipeline() = default;
Pipeline::Pipeline(Pipeline&&) noexcept = default;
Pipeline& Pipeline::operator=(Pipeline&&) noexcept = default;

std::vector<MarkerEstimate> Pipeline::process(std::int64_t capture_ns, std::span<const CameraFrame> frames) {
    State& state = *state_;
    if (state.answered_ns == capture_ns && state.answered_frames == frames.size()) return state.answer;
    if (state.answered_ns && capture_ns < *state.answered_ns) reset();  // another run: its past is not this one's

    state.frames.clear();
    std::ranges::copy_if(frames, std::back_inserter(state.frames), is_measurable);
    state.masks.resize(state.frames.size());
    for (std::size_t i = 0; i < state.frames.size(); ++i)
        state.classifier(state.frames[i].image, state.cones, state.masks[i]);

    state.answer.clear();
    for (std::size_t i = 0; i < state.markers.size(); ++i) state.answer.push_back(state.estimate(i, capture_ns));
    state.answered_ns = capture_ns;
    state.answered_frames = frames.size();
    return state.answer;
}

void Pipeline::reset() {
    std::ranges::fill(state_->tracks, Track{});
    state_->answered_ns.reset();
}

}  // namespace armsight::vision
