#include "service/robot.hpp"

#include <algorithm>
#include <chrono>
#include <exception>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <variant>

#include "armsight/vision/backend.hpp"
#include "service/annotations.hpp"
#include "service/codec.hpp"
#include "service/keys.hpp"
#include "service/logs.hpp"

namespace armsight::vision::service {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

constexpr milliseconds kLook{200};             // how soon a change of the parameters, or silence, is seen
constexpr milliseconds kSilence{2000};         // without frames for longer: waiting, not well
constexpr milliseconds kListenersPeriod{500};  // how often to ask whether anybody wants annotations

std::string configuration_of(const Settings& settings, const Connection& connection) {
    return nlohmann::json{{"connect", settings.connect},           {"namespace", connection.robot},
                          {"zenoh_config", settings.zenoh_config}, {"log_level", settings.log_level},
                          {"backend", settings.backend},           {"shared_memory", connection.shared_memory}}
        .dump();
}

}  // namespace

std::optional<std::pair<double, double>> Rate::add(SteadyTime now, double ms) {
    ++count_;
    sum_ms_ += ms;
    const double seconds = std::chrono::duration<double>(now - since_).count();
    if (seconds < 1.0) return std::nullopt;
    const std::pair result{count_ / seconds, sum_ms_ / count_};
    *this = Rate(now);
    return result;
}

Robot::Robot(Connection connection, const Settings& settings, std::function<void()> wake)
    : connection_(std::move(connection)),
      wake_(std::move(wake)),
      health_(connection_, counters_),
      positions_(connection_.session.declare_publisher(topics::kJointPositions.key, topics::kJointPositions.encoding,
                                                       options_of(topics::kJointPositions))),
      rate_(steady_clock::now()),
      parameters_(connection_.session, {.backend = settings.backend, .colors = {}},
                  configuration_of(settings, connection_), counters_) {
    readers_.emplace_back(connection_, topics::kDescription, "", counters_, [this](const zenoh::Sample& sample) {
        rig_.set(decode_description(sample.get_payload()));
        wake_();
    });
    readers_.emplace_back(connection_, topics::kCameraCalibration, "*", counters_, [this](const zenoh::Sample& sample) {
        rig_.set(std::string(name_before_last(sample.get_keyexpr())), decode_calibration(sample.get_payload()));
        wake_();
    });
    readers_.emplace_back(connection_, topics::kCameraPose, "*", counters_, [this](const zenoh::Sample& sample) {
        rig_.set(std::string(name_before_last(sample.get_keyexpr())), decode_pose(sample.get_payload()));
        wake_();
    });
}

// With its session closed no thread of it waits for anything.
Robot::~Robot() {
    try {
        connection_.session.close();
    } catch (const zenoh::ZException& error) {
        log_warning("the session did not close", {{"robot", connection_.robot}, {"reason", error.what()}});
    }
}

SteadyTime Robot::turn() {
    try {
        std::erase_if(retired_, [](const auto& reader) { return reader->has_ended(); });
        const bool is_new = rig_.version() != built_version_ || parameters_.in_force() != built_with_;
        // who changes names all the time does not get a thread for each
        if (is_new && retired_.empty()) rebuild();
        if (const auto instant = next_instant()) answer(*instant);
        report_health(steady_clock::now());
    } catch (const std::exception& error) {
        pipeline_.reset();
        built_version_.reset();
        health_.report(v1::HEALTH_STATUS_DEGRADED, error.what());
        const auto total = counters_.add("failed_turns");
        if (is_worth_a_line(total)) {
            log_error("an instant could not be measured",
                      {{"robot", connection_.robot}, {"reason", error.what()}, {"total", total}});
        }
    }
    return next_turn();
}

// The next one to measure; nothing while frames of it may still come.
std::optional<Instant> Robot::next_instant() {
    const std::scoped_lock lock(mutex_);
    return pairing_ ? pairing_->take(steady_clock::now()) : std::nullopt;
}

SteadyTime Robot::next_turn() {
    const auto look = steady_clock::now() + kLook;
    const std::scoped_lock lock(mutex_);
    const auto due = pairing_ ? pairing_->due() : std::nullopt;
    return std::min(due.value_or(look), look);
}

// By a reading thread: checks the image and keeps it for a turn without copying its pixels.
void Robot::take_image(const std::string& camera, zenoh::Sample sample) {
    const auto received_ns = static_cast<std::uint64_t>(wall_ns());
    const auto owner = std::make_shared<const zenoh::Sample>(std::move(sample));
    const ImageMessage message = decode_image(owner->get_payload());
    auto checked = validate_image(message.data, message.width, message.height, message.step, message.encoding);
    if (const auto* image = std::get_if<ImageView>(&checked)) {
        const auto size = rig_.size_of(camera);
        if (size && *size != std::pair{image->width, image->height}) {
            checked = Refusal{.counter = "image_refused_calibration",
                              .text = "the calibration is for images of " + std::to_string(size->first) + " x " +
                                      std::to_string(size->second) + ", not " + std::to_string(image->width) + " x " +
                                      std::to_string(image->height)};
        }
    }
    if (const auto* refusal = std::get_if<Refusal>(&checked)) {
        const auto total = counters_.add(refusal->counter);
        if (is_worth_a_line(total)) {
            log_warning(
                "refused an image",
                {{"robot", connection_.robot}, {"camera", camera}, {"reason", refusal->text}, {"total", total}});
        }
        return;
    }
    if (owner->is_shared_memory()) counters_.add("frames_by_shared_memory");
    counters_.add("frames_received");
    {
        const std::scoped_lock lock(mutex_);
        if (!pairing_) return;
        pairing_->add({.camera = camera,
                       .capture_ns = message.capture_ns,
                       .sent_ns = decode_sent_ns(owner->get_attachment()),
                       .received_ns = received_ns,
                       .image = std::get<ImageView>(checked),
                       .owner = owner},
                      steady_clock::now());
    }
    wake_();
}

// From what the bus told of the arm and its cameras, and the parameters in force. A marker's past is kept unless the
// markers, or how their colours are found, change.
void Robot::rebuild() {
    built_version_ = rig_.version();
    const Tunables wanted = parameters_.in_force();
    if (std::exchange(built_with_, wanted) != wanted) pipeline_.reset();
    problem_ = rig_.missing();
    if (!problem_.empty()) return;
    const auto description = rig_.description();
    if (!description) return;
    auto cameras = rig_.cameras();
    for (const Camera& camera : cameras) {
        if (!is_usable(camera)) problem_ = "the calibration of camera " + camera.name + " cannot be used";
    }
    if (!problem_.empty()) return;
    try {
        if (!pipeline_ || markers_ != description->markers) {
            pipeline_.emplace(description->markers, classifier_of(built_with_.backend), built_with_.colors);
            markers_ = description->markers;
        }
    } catch (const std::invalid_argument& error) {
        problem_ = error.what();
        return;
    }
    camera_check_.reset();
    camera_trouble_.clear();
    const bool same_cameras = std::ranges::equal(cameras_, cameras, {}, &Camera::name, &Camera::name);
    cameras_ = std::move(cameras);
    if (!same_cameras) watch_cameras(description->cameras);
}

// Their images from now on, and those of no other. A camera that stays keeps its reader: with two of them an instant
// would come twice.
void Robot::watch_cameras(const std::vector<std::string>& names) {
    for (auto reader = image_readers_.begin(); reader != image_readers_.end();) {
        if (std::ranges::find(names, reader->first) != names.end()) {
            ++reader;
            continue;
        }
        reader->second->request_stop();
        retired_.push_back(std::move(reader->second));
        annotations_.erase(reader->first);
        has_listeners_.erase(reader->first);
        reader = image_readers_.erase(reader);
    }
    {
        const std::scoped_lock lock(mutex_);
        pairing_.emplace(names);
    }
    for (const std::string& name : names) {
        if (!image_readers_.contains(name)) watch_camera(name);
    }
}

void Robot::watch_camera(const std::string& name) {
    annotations_.emplace(name, connection_.session.declare_publisher(key_for(topics::kCameraAnnotations.key, name),
                                                                     topics::kCameraAnnotations.encoding,
                                                                     options_of(topics::kCameraAnnotations)));
    image_readers_.emplace(
        name, std::make_unique<Reader>(connection_, topics::kCameraImage, name, counters_,
                                       [this, name](zenoh::Sample sample) { take_image(name, std::move(sample)); }));
}

void Robot::answer(const Instant& instant) {
    if (!pipeline_) return;
    Pipeline& pipeline = *pipeline_;
    const auto begun = steady_clock::now();
    std::vector<CameraFrame> frames;
    Stages stages{.frames_sent_ns = 0, .received_ns = 0, .sent_ns = 0};
    for (const Frame& frame : instant.frames) {
        const auto camera = std::ranges::find(cameras_, frame.camera, &Camera::name);
        if (camera == cameras_.end()) continue;
        frames.push_back({.camera = &*camera, .image = frame.image});
        stages.frames_sent_ns = std::max(stages.frames_sent_ns, frame.sent_ns);
        stages.received_ns = std::max(stages.received_ns, frame.received_ns);
    }
    pipeline.show_outlines(has_listeners());
    const auto& estimates = pipeline.process(instant.capture_ns, frames);
    stages.sent_ns = static_cast<std::uint64_t>(wall_ns());
    const std::string payload = encode_positions(instant.capture_ns, estimates, stages).SerializeAsString();
    positions_.put(zenoh::as_bytes(payload));
    counters_.add("instants_answered");
    if (frames.size() == cameras_.size()) camera_check_.add(estimates, markers_, cameras_);
    answered_ = steady_clock::now();
    const double ms = std::chrono::duration<double, std::milli>(answered_ - begun).count();
    if (const auto full = rate_.add(answered_, ms)) {
        health_.gauge("rate_hz", full->first);
        health_.gauge("process_ms", full->second);
        for (const auto& [camera, px] : camera_check_.residuals_px()) health_.gauge("reprojection_px_" + camera, px);
        camera_trouble_ = camera_check_.trouble();
    }
    annotate_for_listeners(instant, estimates);
}

// Whether anybody looks at the annotations of any camera; asked of the bus now and then.
bool Robot::has_listeners() {
    const auto now = steady_clock::now();
    if (now - listeners_asked_ > kListenersPeriod) {
        for (const auto& [camera, publisher] : annotations_) has_listeners_[camera] = publisher.has_subscribers();
        listeners_asked_ = now;
    }
    return std::ranges::any_of(has_listeners_, [](const auto& entry) { return entry.second; });
}

void Robot::annotate_for_listeners(const Instant& instant, const std::vector<MarkerEstimate>& estimates) {
    for (const auto& [camera, publisher] : annotations_) {
        if (!has_listeners_[camera]) continue;
        const std::string payload = annotate(instant.capture_ns, camera, estimates).SerializeAsString();
        publisher.put(zenoh::as_bytes(payload));
    }
}

// The session reconnects silently.
void Robot::count_lost_routers() {
    for (; routers_lost_ < connection_.session.routers_lost(); ++routers_lost_) {
        log_warning("lost the router: connecting again until it is there",
                    {{"robot", connection_.robot}, {"total", counters_.add("router_lost")}});
    }
}

void Robot::report_health(SteadyTime now) {
    count_lost_routers();
    if (!problem_.empty()) {
        health_.report(v1::HEALTH_STATUS_WAITING, problem_);
        return;
    }
    if (now - answered_ > kSilence) {
        health_.gauge("rate_hz", 0.0);
        health_.report(v1::HEALTH_STATUS_WAITING, "no frames: is sim running?");
        return;
    }
    std::vector<std::string> gone;
    {
        const std::scoped_lock lock(mutex_);
        if (pairing_) {
            gone = pairing_->gone();
            health_.gauge("frames_unpaired", static_cast<double>(pairing_->dropped()));
        }
    }
    if (gone.empty()) {
        health_.report(camera_trouble_.empty() ? v1::HEALTH_STATUS_OK : v1::HEALTH_STATUS_DEGRADED, camera_trouble_);
    } else {
        health_.report(v1::HEALTH_STATUS_DEGRADED,
                       "no frames from camera " + gone.front() + ": positions from the others");
    }
}

}  // namespace armsight::vision::service
