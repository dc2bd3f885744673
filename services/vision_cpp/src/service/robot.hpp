#pragma once

#include <condition_variable>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "armsight/vision/camera_check.hpp"
#include "armsight/vision/pipeline.hpp"
#include "service/connection.hpp"
#include "service/counters.hpp"
#include "service/health.hpp"
#include "service/pairing.hpp"
#include "service/parameter_server.hpp"
#include "service/reader.hpp"
#include "service/rig.hpp"

namespace armsight::vision::service {

/// Counts what happens in a window of about a second.
class Rate {
  public:
    explicit Rate(SteadyTime now) : since_(now) {}

    /// Adds one of this duration; returns rate and mean duration when a window is full.
    std::optional<std::pair<double, double>> add(SteadyTime now, double ms);

  private:
    SteadyTime since_;
    double count_ = 0;
    double sum_ms_ = 0;
};

/// All that belongs to one robot: its place on the bus, what the bus told of its arm and cameras, the frames that wait,
/// the markers' past, its parameters, counters and health. Threads of its own only read; what takes time is done in
/// turns that the service gives it.
class Robot {
  public:
    /// `wake`: asks for a turn; called from any thread.
    Robot(Connection connection, const Settings& settings, std::function<void()> wake);
    ~Robot();
    Robot(const Robot&) = delete;
    Robot& operator=(const Robot&) = delete;
    Robot(Robot&&) = delete;
    Robot& operator=(Robot&&) = delete;

    /// Answers one instant, if one waits, and says how it is. Not from two threads at once. Never throws: what fails is
    /// counted, told in the log, and costs no other robot anything. Returns when the next turn is due, if nothing
    /// comes.
    SteadyTime turn();

  private:
    void take_image(const std::string& camera, zenoh::Sample sample);
    void rebuild();
    void watch_cameras(const std::vector<std::string>& names);
    void watch_camera(const std::string& name);
    [[nodiscard]] std::optional<Instant> next_instant();
    [[nodiscard]] SteadyTime next_turn();
    void answer(const Instant& instant);
    [[nodiscard]] bool has_listeners();
    void annotate_for_listeners(const Instant& instant, const std::vector<MarkerEstimate>& estimates);
    void count_lost_routers();
    void report_health(SteadyTime now);

    Connection connection_;
    std::function<void()> wake_;
    Counters counters_;
    std::uint64_t routers_lost_ = 0;
    Rig rig_;
    HealthReporter health_;
    zenoh::Publisher positions_;
    std::map<std::string, zenoh::Publisher> annotations_;
    std::map<std::string, bool> has_listeners_;
    SteadyTime listeners_asked_;

    std::mutex mutex_;  // of pairing_
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
    std::vector<std::unique_ptr<Reader>> retired_;  // of cameras that are no more, until their threads have ended
    std::list<Reader> readers_;
};

}  // namespace armsight::vision::service
