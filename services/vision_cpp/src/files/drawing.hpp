#pragma once

#include "files/pictures.hpp"
#include "foxglove/ImageAnnotations.pb.h"

namespace armsight::vision::files {

/// Draws annotations over the picture that they belong to.
void draw(const foxglove::ImageAnnotations& annotations, Picture& picture);

}  // namespace armsight::vision::files
