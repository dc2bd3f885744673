#pragma once

#include <filesystem>
#include <vector>

#include "armsight/vision/camera.hpp"
#include "armsight/vision/description.hpp"

namespace armsight::vision::files {

/// What is looked for, and the cameras that look.
struct Calibrated {
    std::vector<MarkerModel> markers;  ///< and bodies
    std::vector<Camera> cameras;
};

/// Reads the messages that the bus would tell, as JSON: `{"description": ArmDescription, "cameras": {NAME:
/// {"calibration": foxglove.CameraCalibration, "pose": foxglove.FrameTransform}}}`. Of the description only markers and
/// bodies are used. Throws FileError.
[[nodiscard]] Calibrated read_calibration(const std::filesystem::path& path);

}  // namespace armsight::vision::files
