#include "armsight/vision/backend.hpp"

#include <stdexcept>
#include <string>

#include "armsight/vision/opencv_classify.hpp"

namespace armsight::vision {

Classifier classifier_of(std::string_view backend) {
    if (backend == "simd") return classify;
    if (backend != "opencv") throw std::invalid_argument("no backend '" + std::string(backend) + "': simd or opencv");
    return [](const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks) {
        classify_opencv(image, cones, masks);
    };
}

}  // namespace armsight::vision
