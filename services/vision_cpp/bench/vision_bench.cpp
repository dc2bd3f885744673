// The vision kernel beside reading the same bytes and beside OpenCV. Google Benchmark; `make bench-vision` runs it with
// repetitions in random order and compares the medians.

#include <benchmark/benchmark.h>

#include <array>
#include <opencv2/core.hpp>
#include <string>
#include <vector>

#include "armsight/vision/classify.hpp"
#include "armsight/vision/opencv_classify.hpp"
#include "armsight/vision/pipeline.hpp"
#include "scene.hpp"
#include "sum.hpp"

namespace {

using namespace armsight::vision;

constexpr std::int64_t kFramePeriodNs = 33'333'333;
constexpr int kOpening = 3;  // pixels, what masks are usually opened with

testing::Scene arm() {
    const auto markers = testing::arm_markers();
    const std::array<Eigen::Vector3d, 4> centres{
        {{0.0, 0.0, 0.85}, {0.1, 0.2, 4.8}, {1.4, -0.9, 7.1}, {3.1, 1.1, 8.0}}};
    testing::Scene scene;
    for (std::size_t i = 0; i < markers.size(); ++i) {
        scene.spheres.push_back({centres.at(i), markers[i].radius, markers[i].color});
    }
    scene.capsules = {{{0, 0, 0.5}, {0, 0, 4.5}, 0.35},
                      {{0, 0, 4.5}, {1.3, -0.8, 7.0}, 0.2},
                      {{1.3, -0.8, 7.0}, {3.0, 1.0, 7.9}, 0.1}};
    return scene;
}

struct Pair {
    std::array<Camera, 2> cameras{testing::front_camera(), testing::side_camera()};
    std::array<testing::Picture, 2> pictures{testing::draw(arm(), cameras[0]), testing::draw(arm(), cameras[1])};
};

const Pair& pair() {
    static const Pair kPair;
    return kPair;
}

testing::Picture picture(int width, int height) {
    const double focal = pair().cameras[0].K(0, 0) * height / pair().cameras[0].height;
    const Eigen::Vector3d eye = pair().cameras[0].T_world_camera.translation();
    return testing::draw(arm(), testing::camera_at(eye, {0, 0, 5.0}, width, height, focal), 2);
}

void sum_frame(benchmark::State& state, int width, int height) {
    const auto frame = picture(width, height);
    for (auto _ : state) benchmark::DoNotOptimize(sum_bytes(frame.bytes));
}

void classify_frame(benchmark::State& state, int width, int height) {
    const auto frame = picture(width, height);
    const auto cones = color_cones(testing::arm_markers());
    std::vector<MarkerMask> masks;
    for (auto _ : state) classify(frame.view(), cones, masks);
}

void classify_frame_opencv(benchmark::State& state, int width, int height) {
    const auto frame = picture(width, height);
    const auto cones = color_cones(testing::arm_markers());
    std::vector<MarkerMask> masks;
    for (auto _ : state) classify_opencv(frame.view(), cones, masks, kOpening);
}

void sum_pair(benchmark::State& state) {
    for (auto _ : state) {
        for (const auto& frame : pair().pictures) benchmark::DoNotOptimize(sum_bytes(frame.bytes));
    }
}

void opencv_pair(benchmark::State& state) {
    const auto cones = color_cones(testing::arm_markers());
    std::vector<MarkerMask> masks;
    for (auto _ : state) {
        for (const auto& frame : pair().pictures) classify_opencv(frame.view(), cones, masks, kOpening);
    }
}

// `is_known`: whether the markers were seen just before, and are looked for where they were.
void measure_pair(benchmark::State& state, bool is_known) {
    Pipeline pipeline(testing::arm_markers());
    const std::array<CameraFrame, 2> frames{
        CameraFrame{.camera = pair().cameras.data(), .image = pair().pictures[0].view()},
        CameraFrame{.camera = &pair().cameras[1], .image = pair().pictures[1].view()}};
    std::int64_t capture_ns = 0;
    for (auto _ : state) {
        if (!is_known) pipeline.reset();
        benchmark::DoNotOptimize(pipeline.process(capture_ns += kFramePeriodNs, frames).size());
    }
}

}  // namespace

int main(int argc, char** argv) {
    cv::setNumThreads(1);
    const std::array<std::array<int, 2>, 4> sizes{{{640, 480}, {800, 800}, {1280, 720}, {1920, 1080}}};
    for (const auto& [width, height] : sizes) {
        const auto name = [&, w = width, h = height](const std::string& what) {
            return what + "/" + std::to_string(w) + "x" + std::to_string(h);
        };
        benchmark::RegisterBenchmark(name("sum").c_str(), sum_frame, width, height);
        benchmark::RegisterBenchmark(name("classify").c_str(), classify_frame, width, height);
    }
    benchmark::RegisterBenchmark("opencv/800x800", classify_frame_opencv, 800, 800);
    benchmark::RegisterBenchmark("sum/pair", sum_pair);
    benchmark::RegisterBenchmark("opencv/pair", opencv_pair);
    benchmark::RegisterBenchmark("measure/pair", measure_pair, false);
    benchmark::RegisterBenchmark("track/pair", measure_pair, true);
    benchmark::Initialize(&argc, argv);
    if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 1;
    benchmark::RunSpecifiedBenchmarks();
    benchmark::Shutdown();
    return 0;
}
