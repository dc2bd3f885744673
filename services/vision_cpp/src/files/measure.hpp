#pragma once

#include <filesystem>
#include <iosfwd>
#include <string>
#include <utility>
#include <vector>

#include "armsight/vision/classify.hpp"

namespace armsight::vision::files {

/// What to measure without a bus.
struct FileInput {
    std::filesystem::path calibration;
    std::vector<std::pair<std::string, std::filesystem::path>> images;  ///< by camera, of one instant
    std::filesystem::path out;                                          ///< folder for annotated pictures, or empty
};

/// Measures the markers in pictures of one instant: writes armsight.v1.JointPositions as JSON to `json`, and for each
/// picture `NAME.png` with annotations into the folder. Throws FileError before anything is written when the input
/// cannot be used.
void measure(const FileInput& input, Classifier classifier, std::ostream& json);

}  // namespace armsight::vision::files
