#include "search.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

namespace armsight::vision {

Region region_around(const ImageView& image, const Disc& disc, double reach_px) {
    const auto bound = [](double pixels, int size) {
        return static_cast<int>(std::clamp(pixels, 0.0, static_cast<double>(size)));
    };
    return {.x0 = bound(std::floor(disc.centre.x() - reach_px), image.width),
            .y0 = bound(std::floor(disc.centre.y() - reach_px), image.height),
            .x1 = bound(std::ceil(disc.centre.x() + reach_px), image.width),
            .y1 = bound(std::ceil(disc.centre.y() + reach_px), image.height)};
}

bool classify_region(const Classifier& classifier, const ImageView& image, const ColorCone& cone, const Region& region,
                     MarkerMask& mask, std::vector<MarkerMask>& scratch) {
    mask.runs.clear();
    mask.components.clear();
    if (region.x0 >= region.x1 || region.y0 >= region.y1) return true;
    ImageView part = image;
    part.data =
        image.data.subspan(static_cast<std::size_t>(region.y0) * static_cast<std::size_t>(image.step) +
                           static_cast<std::size_t>(region.x0) * static_cast<std::size_t>(layout(image.format).size));
    part.width = region.x1 - region.x0;
    part.height = region.y1 - region.y0;
    scratch.resize(1);
    std::swap(mask, scratch.front());  // keeps its memory
    classifier(part, {&cone, 1}, scratch);
    std::swap(mask, scratch.front());
    for (Run& run : mask.runs) {
        run.y += region.y0;
        run.x0 += region.x0;
        run.x1 += region.x0;
    }
    bool is_whole = true;
    for (Component& c : mask.components) {
        c.sum_x += c.area * region.x0;
        c.sum_y += c.area * region.y0;
        c.x0 += region.x0;
        c.x1 += region.x0;
        c.y0 += region.y0;
        c.y1 += region.y0;
        const bool is_cut = (c.x0 == region.x0 && region.x0 > 0) || (c.y0 == region.y0 && region.y0 > 0) ||
                            (c.x1 == region.x1 && region.x1 < image.width) ||
                            (c.y1 == region.y1 && region.y1 < image.height);
        is_whole = is_whole && !is_cut;
    }
    return is_whole;
}

}  // namespace armsight::vision
