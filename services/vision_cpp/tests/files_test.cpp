#include <gtest/gtest.h>

#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include "files/calibration_file.hpp"
#include "files/drawing.hpp"
#include "files/measure.hpp"
#include "files/pictures.hpp"

namespace armsight::vision::files {
namespace {

namespace fs = std::filesystem;

// A camera 10 m before the origin that looks along y, and a red ball to look for.
constexpr const char* kCalibration = R"({
  "description": {"markers": [{"name": "ball", "radius_m": 0.3, "color": {"red": 1}}]},
  "cameras": {
    "1": {"calibration": {"width": 64, "height": 48, "K": [100, 0, 31.5, 0, 100, 23.5, 0, 0, 1]},
          "pose": {"parent_frame_id": "world", "translation": {"y": -10},
                   "rotation": {"x": -0.7071067811865476, "w": 0.7071067811865476}}}
  }})";

class Files : public ::testing::Test {
  protected:
    void SetUp() override {
        folder_ = fs::temp_directory_path() / ("armsight-files-" + std::to_string(::getpid()));
        fs::create_directories(folder_);
    }
    void TearDown() override { fs::remove_all(folder_); }

    [[nodiscard]] fs::path path(const std::string& name) const { return folder_ / name; }
    [[nodiscard]] fs::path written(const std::string& name, const std::string& text) const {
        std::ofstream(path(name)) << text;
        return path(name);
    }
    [[nodiscard]] std::string refusal(const std::string& text) const {
        try {
            (void)read_calibration(written("c.json", text));
        } catch (const FileError& error) {
            return error.what();
        }
        return "";
    }

  private:
    fs::path folder_;
};

Picture grey(int width, int height) {
    return {.width = width,
            .height = height,
            .rgb = std::vector<std::uint8_t>(static_cast<std::size_t>(width * height * 3), 100)};
}

std::string changed(std::string text, const std::string& from, const std::string& to) {
    const auto at = text.find(from);
    EXPECT_NE(at, std::string::npos);
    return text.replace(at, from.size(), to);
}

TEST_F(Files, PicturesSurviveThePngFile) {
    Picture picture = grey(17, 5);
    picture.rgb[3] = 255;
    write_png(path("a.png"), picture);
    const Picture read = read_picture(path("a.png"));
    EXPECT_EQ(read.width, 17);
    EXPECT_EQ(read.height, 5);
    EXPECT_EQ(read.rgb, picture.rgb);
}

TEST_F(Files, WhatIsNoPictureIsRefused) {
    EXPECT_THROW((void)read_picture(path("none.png")), FileError);
    EXPECT_THROW((void)read_picture(written("text.png", "not a picture")), FileError);
    EXPECT_THROW(write_png(path("no/such/folder/a.png"), grey(16, 16)), FileError);
}

TEST_F(Files, CalibrationGivesMarkersAndCameras) {
    const Calibrated calibrated = read_calibration(written("c.json", kCalibration));
    ASSERT_EQ(calibrated.markers.size(), 1U);
    EXPECT_EQ(calibrated.markers[0].name, "ball");
    ASSERT_EQ(calibrated.cameras.size(), 1U);
    EXPECT_EQ(calibrated.cameras[0].name, "1");
    EXPECT_EQ(calibrated.cameras[0].width, 64);
    EXPECT_EQ(calibrated.cameras[0].K(1, 2), 23.5);
    EXPECT_NEAR(calibrated.cameras[0].T_world_camera.translation().y(), -10.0, 1e-12);
}

TEST_F(Files, CalibrationThatCannotBeUsedIsNamed) {
    const std::string good = kCalibration;
    EXPECT_NE(refusal("[1]").find("no \"description\""), std::string::npos);
    EXPECT_NE(refusal(changed(good, "world", "base")).find("'world'"), std::string::npos);
    EXPECT_NE(refusal(changed(good, "\"1\"", "\"../1\"")).find("plain names"), std::string::npos);
    EXPECT_NE(refusal(changed(good, "\"K\": [100", "\"K\": [0")).find("camera 1 cannot be used"), std::string::npos);
    EXPECT_NE(refusal(changed(good, "\"width\": 64", "\"width\": \"wide\"")).find("CameraCalibration"),
              std::string::npos);
}

TEST_F(Files, FindsTheBallAndDrawsItsOutline) {
    Picture picture = grey(64, 48);
    for (int y = 0; y < 48; ++y) {
        for (int x = 0; x < 64; ++x) {
            const double dx = x - 31.5;
            const double dy = y - 23.5;
            const auto at = static_cast<std::size_t>(3 * (y * 64 + x));
            // 100 px of focal length: at 5 m from the camera, half way, a ball of 0.3 m is 6 px large
            if (dx * dx + dy * dy < 36.0) {
                picture.rgb[at] = 220;
                picture.rgb[at + 1] = picture.rgb[at + 2] = 10;
            }
        }
    }
    write_png(path("1.png"), picture);
    const FileInput input{
        .calibration = written("c.json", kCalibration), .images = {{"1", path("1.png")}}, .out = path("out")};
    std::ostringstream json;
    measure(input, classify, json);
    EXPECT_NE(json.str().find("\"name\": \"ball\""), std::string::npos);
    EXPECT_NE(json.str().find("MARKER_STATUS_ONE_VIEW"), std::string::npos);
    const Picture drawn = read_picture(path("out/1.png"));
    int on_outline = 0;
    for (int y = 0; y < 48; ++y) {
        for (int x = 0; x < 32; ++x) {  // the name is on the right
            if (drawn.rgb.at(static_cast<std::size_t>(3 * (y * 64 + x) + 1)) < 180) continue;
            const double radius = std::hypot(x - 31.5, y - 23.5);
            EXPECT_TRUE(radius < 3.0 || std::abs(radius - 6.0) < 2.0) << x << ", " << y;
            on_outline += radius > 3.0 ? 1 : 0;
        }
    }
    EXPECT_GT(on_outline, 8);
}

TEST_F(Files, ImagesMustFitTheCalibration) {
    write_png(path("small.png"), grey(32, 32));
    write_png(path("good.png"), grey(64, 48));
    const auto calibration = written("c.json", kCalibration);
    const auto measured = [&](std::vector<std::pair<std::string, fs::path>> images) {
        std::ostringstream json;
        measure({.calibration = calibration, .images = std::move(images), .out = {}}, classify, json);
        return json.str();
    };
    EXPECT_THROW((void)measured({{"1", path("small.png")}}), FileError);
    EXPECT_THROW((void)measured({{"2", path("good.png")}}), FileError);
    EXPECT_THROW((void)measured({{"1", path("good.png")}, {"1", path("good.png")}}), FileError);
    EXPECT_NE(measured({{"1", path("good.png")}}).find("MARKER_STATUS_LOST"), std::string::npos);
}

}  // namespace
}  // namespace armsight::vision::files
