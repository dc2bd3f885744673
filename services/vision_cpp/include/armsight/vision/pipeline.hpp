#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "armsight/vision/camera.hpp"
#include "armsight/vision/classify.hpp"
#include "armsight/vision/description.hpp"
#include "armsight/vision/estimate.hpp"
#include "armsight/vision/frame.hpp"

namespace armsight::vision {

/// One image of an instant, with the camera that took it.
struct CameraFrame {
    const Camera* camera = nullptr;
    ImageView image;
};

/// True when the frame can be measured: its camera is usable and calibrated for this size of image.
[[nodiscard]] bool is_measurable(const CameraFrame& frame);

/// From the frames of one instant to the markers' positions. Deterministic; keeps only the markers' last states.
class Pipeline {
  public:
    /// Throws std::invalid_argument when markers cannot be told apart, and says which. A sphere and a box may have the
    /// same colour: shape tells them apart.
    explicit Pipeline(std::vector<MarkerModel> markers, Classifier classifier = classify,
                      const ColorThresholds& thresholds = {});
    ~Pipeline();
    Pipeline(Pipeline&&) noexcept;
    Pipeline& operator=(Pipeline&&) noexcept;
    Pipeline(const Pipeline&) = delete;
    Pipeline& operator=(const Pipeline&) = delete;

    /// One estimate for each marker, in the order of the constructor. Frames that are not measurable are left out.
    /// The instant that was processed last gets the same answer again, without advancing any state.
    /// Valid until the next call; observations name the cameras of `frames`.
    const std::vector<MarkerEstimate>& process(std::int64_t capture_ns, std::span<const CameraFrame> frames);

    /// From now on observations carry corners and inliers, for a person to see; by default they don't.
    void show_outlines(bool shown);

    /// Forgets everything that was seen.
    void reset();

  private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace armsight::vision
