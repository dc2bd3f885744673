#include "armsight/vision/pipeline.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "armsight/vision/classify.hpp"
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
// Middle of a mask without a usable outline: uniform in the disc would be 0.5 radii.
constexpr double kCentreSigmaRadii = 0.4;
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
    void refine(std::size_t marker, const Eigen::Vector3d& position);
    [[nodiscard]] std::vector<View> views() const;
    [[nodiscard]] std::optional<Eigen::Vector3d> first_position(std::size_t marker, std::int64_t capture_ns) const;
    [[nodiscard]] std::optional<Fix> fit(std::size_t marker, const Eigen::Vector3d& start, std::int64_t capture_ns);
    [[nodiscard]] Observation observe(const Sighting& sighting, double radius_m, const Eigen::Vector3d& position) const;
    [[nodiscard]] MarkerEstimate estimate(std::size_t marker, std::int64_t capture_ns);
};

// First look: the largest patch of the colour in each frame, and the cone through its outline.
void Pipeline::State::look(std::size_t marker) {
    sightings.clear();
    for (std::size_t i = 0; i < frames.size(); ++i) {
        const Component* component = largest(masks[i][marker]);
        if (component == nullptr) continue;
        const Camera& camera = *frames[i].camera;
        // of a part of the disc: its extent is nearer to the truth than its area
        const double extent = 0.5 * std::max(component->x1 - component->x0, component->y1 - component->y0);
        const double from_area = std::sqrt(static_cast<double>(component->area) / std::numbers::pi);
        Sighting sighting{.frame = i,
                          .outline = {},
                          .cone = std::nullopt,
                          .disc = {.centre = component->centroid(), .radius = std::max(extent, from_area)},
                          .centre = {}};
        for (int pass = 0; pass < 2; ++pass) {
            find_edges(frames[i].image, camera, cones[marker], masks[i][marker], sighting.disc, scratch,
                       sighting.outline);
            sighting.cone = fit_cone(sighting.outline.points);
            if (!sighting.cone) break;
            sighting.disc = disc_of(camera, sighting.cone->axis, sighting.cone->half_angle, sighting.disc);
        }
        sighting.centre = ray(camera, sighting.disc.centre.x(), sighting.disc.centre.y());
        sighting.has_outline = sighting.cone.has_value();
        sightings.push_back(std::move(sighting));
    }
}

// Second look: where the sphere is known to be, its parts on both sides of an occluder belong together.
void Pipeline::State::refine(std::size_t marker, const Eigen::Vector3d& position) {
    for (Sighting& sighting : sightings) {
        const CameraFrame& frame = frames[sighting.frame];
        sighting.disc = disc_of(*frame.camera, position, markers[marker].radius);
        find_edges(frame.image, *frame.camera, cones[marker], masks[sighting.frame][marker], sighting.disc, scratch,
                   sighting.outline);
        sighting.cone = fit_cone(sighting.outline.points);
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
        const double sigma = std::max(kMinCentreSigmaPx, kCentreSigmaRadii * sighting.disc.radius);
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

// Where to start the fit: rays of two views, else one ray and the distance that radius and last state tell.
std::optional<Eigen::Vector3d> Pipeline::State::first_position(std::size_t marker, std::int64_t capture_ns) const {
    std::vector<Ray> rays;
    rays.reserve(sightings.size());
    for (const Sighting& s : sightings) rays.push_back(world_ray(*frames[s.frame].camera, s.centre));
    if (auto point = triangulate(rays)) return point;
    const auto prior = tracks[marker].predict(capture_ns);
    if (sightings.empty()) return std::nullopt;
    const Ray& first = rays.front();
    const auto& cone = sightings.front().cone;
    if (cone) return first.origin + markers[marker].radius / std::sin(cone->half_angle) * first.direction;
    if (!prior) return std::nullopt;
    const double along = std::max(first.direction.dot(prior->position - first.origin), 2.0 * markers[marker].radius);
    return first.origin + along * first.direction;
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
    const auto own = sighting.cone ? project(camera, sighting.cone->axis) : std::nullopt;
    const Eigen::Vector2d centre = own.value_or(sighting.outline.centroid);
    const auto area = static_cast<double>(sighting.outline.area);
    const double whole = std::numbers::pi * std::max(disc.radius * disc.radius, 1.0);
    return {.camera = camera.name,
            .u = centre.x() - kWireToImage,
            .v = centre.y() - kWireToImage,
            .radius_px = disc.radius,
            .area_px = area,
            .visible = std::clamp(area / whole, 0.0, 1.0)};
}

MarkerEstimate Pipeline::State::estimate(std::size_t marker, std::int64_t capture_ns) {
    const MarkerModel& model = markers[marker];
    Track& track = tracks[marker];
    look(marker);
    std::optional<Fix> fix;
    // each round may find that a view saw something else; at most all are dropped
    for (std::size_t round = 0; round < frames.size() && !sightings.empty(); ++round) {
        auto start = first_position(marker, capture_ns);
        if (!start) break;
        fix = fit(marker, *start, capture_ns);
        if (!fix) break;
        refine(marker, fix->position);
        if (sightings.empty()) {
            fix.reset();
            break;
        }
        fix = fit(marker, fix->position, capture_ns);
        if (!fix) break;
        const auto all = views();
        std::size_t worst = 0;
        double least = 1.0;
        for (std::size_t i = 0; i < all.size(); ++i) {
            const double share =
                all[i].outline.empty() ? 1.0 : agreement(all[i], model.radius, fix->position, kAgreementPx);
            if (share < least) {
                least = share;
                worst = i;
            }
        }
        if (least >= kMinAgreement) break;
        sightings.erase(sightings.begin() + static_cast<std::ptrdiff_t>(worst));
        fix.reset();
    }

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
        track.update(capture_ns, fix->position, fix->covariance);
    } else if (const auto prior = track.predict(capture_ns)) {
        result.position = prior->position;
        result.covariance = prior->covariance;
    }
    return result;
}

Pipeline::Pipeline(std::vector<MarkerModel> markers) : state_(std::make_unique<State>()) {
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
    for (std::size_t i = 0; i < state.frames.size(); ++i) classify(state.frames[i].image, state.cones, state.masks[i]);

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
