#pragma once

#include <span>
#include <vector>

#include "armsight/vision/classify.hpp"

namespace armsight::vision {

/// classify() in its plain form, with OpenCV's functions on whole images in floating point: RGB normalised by the sum
/// of its channels (the report's first step), a range for each colour, connected components with statistics. Without
/// opening, the masks and components are those of classify(), pixel for pixel; it is the reference of tests and
/// benchmarks, and the service's `--backend opencv`.
///
/// `opening` is the side of the square that the masks are opened with, in pixels; 0 for none. Opening removes speckle
/// and moves centroids by up to 1.8 px.
void classify_opencv(const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks,
                     int opening = 0);

}  // namespace armsight::vision
