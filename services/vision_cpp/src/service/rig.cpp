#include "service/rig.hpp"

#include <utility>

namespace armsight::vision::service {
namespace {

// Cameras come by name from the bus: somebody who makes up names must not fill the memory.
constexpr std::size_t kMaxKnownCameras = 64;

template <typename Map, typename Value>
void put(Map& map, const std::string& name, const Value& value) {
    if (map.size() >= kMaxKnownCameras && !map.contains(name)) {
        throw MalformedMessage("more than 64 cameras on the bus");
    }
    map.insert_or_assign(name, value);
}

}  // namespace

void Rig::set(Description description) {
    const std::scoped_lock lock(mutex_);
    description_ = std::move(description);
    ++version_;
}

void Rig::set(const std::string& camera, const Calibration& calibration) {
    const std::scoped_lock lock(mutex_);
    put(calibrations_, camera, calibration);
    ++version_;
}

void Rig::set(const std::string& camera, const Eigen::Isometry3d& pose) {
    const std::scoped_lock lock(mutex_);
    put(poses_, camera, pose);
    ++version_;
}

std::uint64_t Rig::version() const {
    const std::scoped_lock lock(mutex_);
    return version_;
}

std::optional<Description> Rig::description() const {
    const std::scoped_lock lock(mutex_);
    return description_;
}

std::vector<Camera> Rig::cameras() const {
    const std::scoped_lock lock(mutex_);
    std::vector<Camera> result;
    if (!description_) return result;
    for (const std::string& name : description_->cameras) {
        const auto calibration = calibrations_.find(name);
        const auto pose = poses_.find(name);
        if (calibration == calibrations_.end() || pose == poses_.end()) continue;
        result.push_back({.name = name,
                          .width = calibration->second.width,
                          .height = calibration->second.height,
                          .K = calibration->second.K,
                          .distortion = calibration->second.distortion,
                          .T_world_camera = pose->second});
    }
    return result;
}

std::string Rig::missing() const {
    const std::scoped_lock lock(mutex_);
    if (!description_) return "no description of the arm yet: is sim running?";
    if (description_->cameras.size() < 2) return "the description names fewer than two cameras";
    for (const std::string& name : description_->cameras) {
        if (!calibrations_.contains(name)) return "no calibration of camera " + name + " yet";
        if (!poses_.contains(name)) return "no pose of camera " + name + " yet";
    }
    return "";
}

std::optional<std::pair<int, int>> Rig::size_of(const std::string& camera) const {
    const std::scoped_lock lock(mutex_);
    const auto found = calibrations_.find(camera);
    if (found == calibrations_.end()) return std::nullopt;
    return std::pair{found->second.width, found->second.height};
}

}  // namespace armsight::vision::service
