#pragma once

#include <cstdint>
#include <span>
#include <string_view>

#include "armsight/vision/estimate.hpp"
#include "foxglove/ImageAnnotations.pb.h"

namespace armsight::vision::service {

/// Outline, inliers, centre, name and status of every marker that one camera saw, to draw over its image.
[[nodiscard]] foxglove::ImageAnnotations annotate(std::int64_t capture_ns, std::string_view camera,
                                                  std::span<const MarkerEstimate> estimates);

}  // namespace armsight::vision::service
