// Medians of interleaved runs over the same two frames, in thread CPU time; one JSON object on standard output.

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <functional>
#include <map>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "armsight/vision/classify.hpp"
#include "armsight/vision/pipeline.hpp"
#include "scene.hpp"

namespace {

using namespace armsight::vision;

constexpr int kRounds = 60;
constexpr int kWarmUp = 5;

double thread_ms() {
    timespec now{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return static_cast<double>(now.tv_sec) * 1e3 + static_cast<double>(now.tv_nsec) * 1e-6;
}

volatile std::uint64_t sink;  // what is computed must not be optimised away

// As fast as memory gives them: whole words, in four sums so that none waits for another.
void read_bytes(const testing::Picture& picture) {
    std::array<std::uint64_t, 4> sums{};
    std::array<std::uint64_t, 4> words{};
    for (std::size_t i = 0; i + sizeof(words) <= picture.bytes.size(); i += sizeof(words)) {
        std::memcpy(words.data(), picture.bytes.data() + i, sizeof(words));
        for (std::size_t k = 0; k < words.size(); ++k) sums[k] += words[k];
    }
    sink = sums[0] + sums[1] + sums[2] + sums[3];
}

// What the report does: chromaticity in floating point, a threshold for each colour, components.
void opencv_chain(const testing::Picture& picture) {
    const cv::Mat image(picture.height, picture.width, CV_8UC3, const_cast<std::uint8_t*>(picture.bytes.data()));
    cv::Mat real;
    image.convertTo(real, CV_32FC3);
    std::array<cv::Mat, 3> channels;
    cv::split(real, channels.data());
    const cv::Mat sum = channels[0] + channels[1] + channels[2] + 1.0F;
    for (cv::Mat& channel : channels) channel /= sum;
    cv::Mat normalised;
    cv::merge(channels.data(), 3, normalised);
    const std::array<std::pair<cv::Scalar, cv::Scalar>, 4> bounds{{{{0.0, 0.6, 0.0}, {0.25, 1.0, 0.25}},
                                                                   {{0.35, 0.35, 0.0}, {0.6, 0.6, 0.2}},
                                                                   {{0.0, 0.0, 0.6}, {0.25, 0.25, 1.0}},
                                                                   {{0.6, 0.0, 0.0}, {1.0, 0.25, 0.25}}}};
    for (const auto& [low, high] : bounds) {
        cv::Mat mask;
        cv::inRange(normalised, low, high, mask);
        cv::Mat labels;
        cv::Mat stats;
        cv::Mat centroids;
        sink = static_cast<std::uint64_t>(cv::connectedComponentsWithStats(mask, labels, stats, centroids));
    }
}

testing::Scene arm() {
    const auto markers = testing::arm_markers();
    const Eigen::Vector3d centres[] = {{0.0, 0.0, 0.85}, {0.1, 0.2, 4.8}, {1.4, -0.9, 7.1}, {3.1, 1.1, 8.0}};
    testing::Scene scene;
    for (std::size_t i = 0; i < markers.size(); ++i)
        scene.spheres.push_back({centres[i], markers[i].radius, markers[i].color});
    scene.capsules = {{{0, 0, 0.5}, {0, 0, 4.5}, 0.35},
                      {{0, 0, 4.5}, {1.3, -0.8, 7.0}, 0.2},
                      {{1.3, -0.8, 7.0}, {3.0, 1.0, 7.9}, 0.1}};
    return scene;
}

}  // namespace

int main() {
    cv::setNumThreads(1);
    const std::array<Camera, 2> cameras{testing::front_camera(), testing::side_camera()};
    const testing::Scene scene = arm();
    const std::array<testing::Picture, 2> pictures{testing::draw(scene, cameras[0]), testing::draw(scene, cameras[1])};
    const auto cones = color_cones(testing::arm_markers());
    std::vector<MarkerMask> masks;
    Pipeline pipeline(testing::arm_markers());
    std::int64_t capture_ns = 0;

    const std::map<std::string, std::function<void()>> contestants{
        {"read", [&] { read_bytes(pictures[0]); }},
        {"opencv", [&] { opencv_chain(pictures[0]); }},
        {"classify", [&] { classify(pictures[0].view(), cones, masks); }},
        {"pair",
         [&] {
             const std::array<CameraFrame, 2> frames{CameraFrame{.camera = cameras.data(), .image = pictures[0].view()},
                                                     CameraFrame{.camera = &cameras[1], .image = pictures[1].view()}};
             sink = pipeline.process(++capture_ns, frames).size();
         }},
    };
    std::map<std::string, std::vector<double>> times;
    for (int round = -kWarmUp; round < kRounds; ++round) {
        for (const auto& [name, run] : contestants) {
            const double began = thread_ms();
            run();
            if (round >= 0) times[name].push_back(thread_ms() - began);
        }
    }
    std::printf("{");
    const char* separator = "";
    for (auto& [name, values] : times) {
        std::ranges::sort(values);
        std::printf("%s\"%s\": {\"p50_ms\": %.4f, \"p99_ms\": %.4f}", separator, name.c_str(),
                    values[values.size() / 2], values[values.size() * 99 / 100]);
        separator = ", ";
    }
    std::printf("}\n");
    return 0;
}
