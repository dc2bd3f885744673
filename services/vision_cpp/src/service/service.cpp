#include "service/service.hpp"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <iostream>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <variant>

#include "armsight/vision/backend.hpp"
#include "armsight/vision/camera_check.hpp"
#include "armsight/vision/pipeline.hpp"
#include "service/annotations.hpp"
#include "service/codec.hpp"
#include "service/counters.hpp"
#include "service/health.hpp"
#include "service/keys.hpp"
#include "service/logs.hpp"
#include "service/pairing.hpp"
#include "service/parameter_server.hpp"
#include "service/reader.hpp"
#include "service/rig.hpp"
#include "service/session_config.hpp"
#include "service/shared_memory.hpp"

namespace armsight::vision::service {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

constexpr milliseconds kPoll{20};              // how soon a stop or a change of the rig is seen
constexpr milliseconds kSilence{2000};         // without frames for longer: waiting, not well
constexpr milliseconds kListenersPeriod{500};  // how often to ask whether anybody wants annotations
constexpr milliseconds kRetry{100};
constexpr milliseconds kProbe{3000};
constexpr int kHintAfterAttempts = 4;

struct Opened {
    zenoh::Session session;
    bool shared_memory;
};

// Waits for the router. Goes without shared memory where that can't be had, and says why.
std::optional<Opened> open_session(const Settings& settings, bool shared_memory, const std::atomic<bool>& stop) {
    zenoh::init_log();
    std::optional<zenoh::Config> config;
    std::string known;
    for (int attempt = 1; !stop; ++attempt) {
        const std::string in_the_way = shared_memory ? why_no_shared_memory() : "";
        const bool has_it = shared_memory && in_the_way.empty();
        if (!config || in_the_way != known) {
            config = session_config(settings, has_it);
            known = in_the_way;
            if (!has_it && shared_memory) log_warning("no shared memory: " + in_the_way);
        }
        try {
            return Opened{zenoh::Session::open(*config), has_it};
        } catch (const zenoh::ZException& error) {
            if (attempt % 20 == kHintAfterAttempts) {
                log_warning(
                    "no router yet, still trying: start one with `armsight up` or `armsight router`; with "
                    "certificates, `armsight status` with this --zenoh-config says what is wrong with them",
                    {{"endpoints", config->get_json("connect/endpoints")}, {"error", error.what()}});
            }
        }
        std::this_thread::sleep_for(kRetry);
    }
    return std::nullopt;
}

// Counts what happens in a window of about a second.
class Rate {
  public:
    // Adds one of this duration; returns rate and mean duration when a window is full.
    std::optional<std::pair<double, double>> add(SteadyTime now, double ms) {
        ++count_;
        sum_ms_ += ms;
        const double seconds = std::chrono::duration<double>(now - since_).count();
        if (seconds < 1.0) return std::nullopt;
        const std::pair result{count_ / seconds, sum_ms_ / count_};
        *this = Rate(now);
        return result;
    }
    explicit Rate(SteadyTime now) : since_(now) {}

  private:
    SteadyTime since_;
    double count_ = 0;
    double sum_ms_ = 0;
};

std::string configuration_of(const Settings& settings, bool shared_memory) {
    return nlohmann::json{{"connect", settings.connect},           {"namespace", settings.name_space},
                          {"zenoh_config", settings.zenoh_config}, {"log_level", settings.log_level},
                          {"backend", settings.backend},           {"shared_memory", shared_memory}}
        .dump();
}

class Service {
  public:
    Service(const zenoh::Session& session, const Settings& settings, bool shared_memory);
    void loop(const std::atomic<bool>& stop);

  private:
    void take_image(const std::string& camera, zenoh::Sample sample);
    void rebuild();
    void answer(const Instant& instant);
    [[nodiscard]] bool has_listeners();
    void annotate_for_listeners(const Instant& instant, const std::vector<MarkerEstimate>& estimates);
    void count_lost_routers();
    void report_health(SteadyTime now);

    const zenoh::Session& session_;
    Counters counters_;
    std::uint64_t routers_lost_ = 0;
    Rig rig_;
    HealthReporter health_;
    zenoh::Publisher positions_;
    std::map<std::string, zenoh::Publisher> annotations_;
    std::map<std::string, bool> has_listeners_;
    SteadyTime listeners_asked_;

    std::mutex mutex_;  // of pairing_
    std::condition_variable arrived_;
    std::optional<Pairing> pairing_;

    std::optional<std::uint64_t> built_version_;
    std::string problem_;  // why nothing can be built from what the bus told
    std::vector<Camera> cameras_;
    std::vector<MarkerModel> markers_;
    std::optional<Pipeline> pipeline_;
    SteadyTime answered_;
    Rate rate_;
    CameraCheck camera_check_;
    std::string camera_trouble_;

    ParameterServer parameters_;
    Tunables built_with_;
    std::map<std::string, std::unique_ptr<Reader>> image_readers_;
    std::list<Reader> readers_;
};

Service::Service(const zenoh::Session& session, const Settings& settings, bool shared_memory)
    : session_(session),
      health_(session, counters_),
      positions_(session.declare_publisher(topics::kJointPositions.key, topics::kJointPositions.encoding,
                                           options_of(topics::kJointPositions))),
      rate_(steady_clock::now()),
      parameters_(session, {.backend = settings.backend, .colors = {}}, configuration_of(settings, shared_memory),
                  counters_) {
    readers_.emplace_back(session, topics::kDescription, "", counters_,
                          [this](const zenoh::Sample& sample) { rig_.set(decode_description(sample.get_payload())); });
    readers_.emplace_back(session, topics::kCameraCalibration, "*", counters_, [this](const zenoh::Sample& sample) {
        rig_.set(std::string(name_before_last(sample.get_keyexpr())), decode_calibration(sample.get_payload()));
    });
    readers_.emplace_back(session, topics::kCameraPose, "*", counters_, [this](const zenoh::Sample& sample) {
        rig_.set(std::string(name_before_last(sample.get_keyexpr())), decode_pose(sample.get_payload()));
    });
}

void Service::loop(const std::atomic<bool>& stop) {
    while (!stop) {
        if (rig_.version() != built_version_ || parameters_.in_force() != built_with_) rebuild();
        std::optional<Instant> instant;
        {
            std::unique_lock lock(mutex_);
            const auto ready = [&] {
                if (pairing_) instant = pairing_->take(steady_clock::now());
                return instant.has_value();
            };
            arrived_.wait_for(lock, kPoll, ready);
        }
        if (instant) answer(*instant);
        report_health(steady_clock::now());
    }
}

// By a reading thread: checks the image and hands it to the loop without copying its pixels.
void Service::take_image(const std::string& camera, zenoh::Sample sample) {
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
            log_warning("refused an image", {{"camera", camera}, {"reason", refusal->text}, {"total", total}});
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
    arrived_.notify_one();
}

// From what the bus told of the arm and its cameras, and the parameters in force. A marker's past is kept unless the
// markers, or how their colours are found, change.
void Service::rebuild() {
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
    if (same_cameras) return;
    image_readers_.clear();
    annotations_.clear();
    {
        const std::scoped_lock lock(mutex_);
        pairing_.emplace(description->cameras);
    }
    for (const Camera& camera : cameras_) {
        annotations_.emplace(
            camera.name,
            session_.declare_publisher(key_for(topics::kCameraAnnotations.key, camera.name),
                                       topics::kCameraAnnotations.encoding, options_of(topics::kCameraAnnotations)));
        image_readers_.emplace(camera.name,
                               std::make_unique<Reader>(session_, topics::kCameraImage, camera.name, counters_,
                                                        [this, name = camera.name](zenoh::Sample sample) {
                                                            take_image(name, std::move(sample));
                                                        }));
    }
}

void Service::answer(const Instant& instant) {
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
bool Service::has_listeners() {
    const auto now = steady_clock::now();
    if (now - listeners_asked_ > kListenersPeriod) {
        for (const auto& [camera, publisher] : annotations_) has_listeners_[camera] = publisher.has_subscribers();
        listeners_asked_ = now;
    }
    return std::ranges::any_of(has_listeners_, [](const auto& entry) { return entry.second; });
}

void Service::annotate_for_listeners(const Instant& instant, const std::vector<MarkerEstimate>& estimates) {
    for (const auto& [camera, publisher] : annotations_) {
        if (!has_listeners_[camera]) continue;
        const std::string payload = annotate(instant.capture_ns, camera, estimates).SerializeAsString();
        publisher.put(zenoh::as_bytes(payload));
    }
}

// The session reconnects silently.
void Service::count_lost_routers() {
    for (; routers_lost_ < session_.routers_lost(); ++routers_lost_) {
        log_warning("lost the router: connecting again until it is there", {{"total", counters_.add("router_lost")}});
    }
}

void Service::report_health(SteadyTime now) {
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

}  // namespace

int run(const Settings& settings, const std::atomic<bool>& stop) {
    auto opened = open_session(settings, settings.shared_memory, stop);
    if (!opened) return 0;
    {
        Service service(opened->session, settings, opened->shared_memory);
        service.loop(stop);
    }
    opened->session.close();
    return 0;
}

int probe(const Settings& settings) {
    std::atomic<bool> late{false};
    const std::jthread timer([&late](const std::stop_token& stop) {
        for (const auto until = steady_clock::now() + kProbe; steady_clock::now() < until && !stop.stop_requested();) {
            std::this_thread::sleep_for(milliseconds{20});
        }
        late = true;
    });
    try {
        auto opened = open_session(settings, false, late);
        if (!opened) throw std::runtime_error("no router within 3 s");
        std::string text;
        try {
            (void)opened->session.get(key_for(topics::kParametersQuery.key, "vision"), {}, kProbe);
        } catch (const zenoh::ZException& error) {
            text = error.what();
        }
        opened->session.close();
        if (!text.empty()) throw std::runtime_error(text);
    } catch (const ConfigError&) {
        throw;
    } catch (const std::exception& error) {
        std::cerr << "vision: " << error.what() << '\n';
        return 1;
    }
    return 0;
}

}  // namespace armsight::vision::service
