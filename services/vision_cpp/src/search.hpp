#pragma once

#include <optional>
#include <vector>

#include "armsight/vision/classify.hpp"
#include "armsight/vision/edges.hpp"

namespace armsight::vision {

/// Part of an image, half open.
struct Region {
    int x0, y0, x1, y1;  ///< pixels
};

/// The square of side 2 `reach_px` around the middle of a disc, as far as it lies in the image; empty where it doesn't.
[[nodiscard]] Region region_around(const ImageView& image, const Disc& disc, double reach_px);

/// classify() for one colour in one region: as if all other pixels were grey. `scratch` is kept by the caller.
/// Returns false when a patch reaches a side of the region within the image: it may go on beyond.
[[nodiscard]] bool classify_region(const Classifier& classifier, const ImageView& image, const ColorCone& cone,
                                   const Region& region, MarkerMask& mask, std::vector<MarkerMask>& scratch);

}  // namespace armsight::vision
