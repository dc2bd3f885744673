#pragma once

#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "armsight/vision/camera.hpp"
#include "service/codec.hpp"

namespace armsight::vision::service {

/// Arm and cameras as told by the bus so far, in whatever order; safe from every thread.
class Rig {
  public:
    void set(Description description);
    void set(const std::string& camera, const Calibration& calibration);
    void set(const std::string& camera, const Eigen::Isometry3d& pose);

    /// Changes with every set.
    [[nodiscard]] std::uint64_t version() const;

    [[nodiscard]] std::optional<Description> description() const;

    /// The description's cameras that have a calibration and a pose.
    [[nodiscard]] std::vector<Camera> cameras() const;

    /// One line on what is missing; empty when nothing is.
    [[nodiscard]] std::string missing() const;

    /// The size that images of this camera must have; nothing while it is not known.
    [[nodiscard]] std::optional<std::pair<int, int>> size_of(const std::string& camera) const;

  private:
    mutable std::mutex mutex_;
    std::uint64_t version_ = 0;
    std::optional<Description> description_;
    std::map<std::string, Calibration> calibrations_;
    std::map<std::string, Eigen::Isometry3d> poses_;
};

}  // namespace armsight::vision::service
