#include "files/measure.hpp"

#include <google/protobuf/util/json_util.h>

#include <algorithm>
#include <map>
#include <ostream>
#include <utility>
#include <variant>

#include "armsight/vision/pipeline.hpp"
#include "files/calibration_file.hpp"
#include "files/drawing.hpp"
#include "files/pictures.hpp"
#include "service/annotations.hpp"
#include "service/codec.hpp"

namespace armsight::vision::files {
namespace {

constexpr std::int64_t kInstant = 0;  // files do not say when they were taken

CameraFrame frame_of(const Camera& camera, const Picture& picture) {
    const auto width = static_cast<std::uint32_t>(picture.width);
    const auto height = static_cast<std::uint32_t>(picture.height);
    auto checked = validate_image(picture.rgb, width, height, 3 * width, "rgb8");
    if (const auto* refusal = std::get_if<Refusal>(&checked)) {
        throw FileError("the image of camera " + camera.name + " cannot be used: " + refusal->text);
    }
    CameraFrame frame{.camera = &camera, .image = std::get<ImageView>(checked)};
    if (!is_measurable(frame)) {
        throw FileError("camera " + camera.name + " is calibrated for images of " + std::to_string(camera.width) +
                        " x " + std::to_string(camera.height) + ", not " + std::to_string(picture.width) + " x " +
                        std::to_string(picture.height));
    }
    return frame;
}

std::string json_of(const v1::JointPositions& positions) {
    google::protobuf::util::JsonPrintOptions options;
    options.add_whitespace = true;
    options.preserve_proto_field_names = true;
    std::string text;
    const auto status = google::protobuf::util::MessageToJsonString(positions, &text, options);
    if (!status.ok()) throw FileError("no JSON of the positions: " + std::string(status.message()));
    return text;
}

}  // namespace

void measure(const FileInput& input, Classifier classifier, std::ostream& json) {
    const Calibrated calibrated = read_calibration(input.calibration);
    std::map<std::string, Picture> pictures;
    std::vector<CameraFrame> frames;
    for (const auto& [name, path] : input.images) {
        const auto camera = std::ranges::find(calibrated.cameras, name, &Camera::name);
        if (camera == calibrated.cameras.end()) {
            throw FileError(input.calibration.string() + " has no camera " + name);
        }
        const auto [picture, is_new] = pictures.emplace(name, read_picture(path));
        if (!is_new) throw FileError("two images of camera " + name);
        frames.push_back(frame_of(*camera, picture->second));
    }
    if (!input.out.empty()) {
        std::error_code error;
        std::filesystem::create_directories(input.out, error);
        if (error) throw FileError(input.out.string() + " cannot be made: " + error.message());
    }
    Pipeline pipeline(calibrated.markers, std::move(classifier));
    pipeline.show_outlines(true);
    const auto estimates = pipeline.process(kInstant, frames);
    json << json_of(service::encode_positions(kInstant, estimates, {}));
    if (input.out.empty()) return;
    for (auto& [name, picture] : pictures) {
        draw(service::annotate(kInstant, name, estimates), picture);
        write_png(input.out / (name + ".png"), picture);
    }
}

}  // namespace armsight::vision::files
