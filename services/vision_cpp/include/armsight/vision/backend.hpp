#pragma once

#include <array>
#include <string_view>

#include "armsight/vision/classify.hpp"

namespace armsight::vision {

inline constexpr std::array<std::string_view, 2> kBackends{"simd", "opencv"};

/// What finds the markers' pixels, by its name on the command line: `simd` (classify()) or `opencv`
/// (classify_opencv()). Throws std::invalid_argument for another name.
[[nodiscard]] Classifier classifier_of(std::string_view backend);

}  // namespace armsight::vision
