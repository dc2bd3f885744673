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
    const Camera* camera;
    ImageView image;
};

/// True when the frame can be measured: its camera is usable and calibrated for this size of image.
[[nodiscard]] bool is_measurable(const CameraFrame& frame);

/// From the frames of one instant to the markers' positions. Deterministic; keeps only the markers' last states.
class Pipeline {
  public:
    /// Throws std::invalid_argument when markers cannot be told apart by colour, and says which.
    explicit Pipeline(std::vector<MarkerModel> markers, Classifier classifier = classify);
    ~Pipeline();
    Pipeline(Pipeline&&) noexcept;
    Pipeline& operator=(Pipeline&&) noexcept;
    Pipeline(const Pipeline&) = delete;
    Pipeline& operator=(const Pipeline&) = delete;

    /// One estimate for each marker, in the order of the constructor. Frames that are not measurable are left out.
    /// The instant that was processed last gets the same answer again, without advancing any state.
    std::vector<MarkerEstimate> process(std::int64_t capture_ns, std::span<const CameraFrame> frames);

    /// Forgets everything that was seen.
    void reset();

  private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace armsight::vision
