#include "armsight/vision/opencv_classify.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <opencv2/imgproc.hpp>

namespace armsight::vision {
namespace {

// Planes have whole coefficients and pixels whole channels: just outside of a plane the sum of products is -1 at most,
// divided by the sum of the channels -1 / 765. Half of that tells it from 0, whatever floats round.
constexpr double kJustInside = -0.5 / 765.0;

struct Planes {
    cv::Mat rgb;         // CV_32FC3, 0 to 255
    cv::Mat normalised;  // CV_32FC3, each channel's share of the sum
};

Planes normalise(const ImageView& image) {
    const PixelLayout order = layout(image.format);
    // OpenCV has no view of constant pixels; nothing below writes to it
    const cv::Mat bytes(image.height, image.width, CV_MAKETYPE(CV_8U, order.size),
                        const_cast<std::uint8_t*>(image.data.data()),  // NOLINT(cppcoreguidelines-pro-type-const-cast)
                        static_cast<std::size_t>(image.step));
    cv::Mat real;
    bytes.convertTo(real, CV_MAKETYPE(CV_32F, order.size));
    std::array<cv::Mat, 4> read;
    cv::split(real, read.data());
    const auto channel = [&](int index) -> const cv::Mat& { return read.at(static_cast<std::size_t>(index)); };
    std::array<cv::Mat, 3> channels{channel(order.red), channel(order.green), channel(order.blue)};
    Planes planes;
    cv::merge(channels.data(), channels.size(), planes.rgb);
    cv::Mat sum = channels[0] + channels[1] + channels[2];
    cv::max(sum, 1.0, sum);  // black stays black
    std::array<cv::Mat, 3> shares;
    for (std::size_t i = 0; i < shares.size(); ++i) cv::divide(channels.at(i), sum, shares.at(i));
    cv::merge(shares.data(), shares.size(), planes.normalised);
    return planes;
}

cv::Mat mask_of(const Planes& planes, const ColorCone& cone) {
    cv::Matx33f borders;
    cv::Matx13f hue;
    for (int i = 0; i < 3; ++i) {
        const auto k = static_cast<std::size_t>(i);
        borders(0, i) = cone.saturation.at(k);
        borders(1, i) = cone.left.at(k);
        borders(2, i) = cone.right.at(k);
        hue(0, i) = cone.hue.at(k);
    }
    cv::Mat within;
    cv::transform(planes.normalised, within, borders);
    cv::Mat mask;
    cv::inRange(within, cv::Scalar::all(kJustInside), cv::Scalar::all(std::numeric_limits<float>::max()), mask);
    cv::Mat chroma;
    cv::transform(planes.rgb, chroma, hue);
    cv::Mat colored;
    cv::inRange(chroma, cv::Scalar(cone.floor - 0.5), cv::Scalar(std::numeric_limits<float>::max()), colored);
    cv::bitwise_and(mask, colored, mask);
    return mask;
}

void describe(const cv::Mat& binary, MarkerMask& mask) {
    mask.runs.clear();
    mask.components.clear();
    cv::Mat labels;
    cv::Mat stats;
    cv::Mat centroids;
    const int count = cv::connectedComponentsWithStats(binary, labels, stats, centroids, 8, CV_32S);
    std::vector<int> number(static_cast<std::size_t>(count), -1);  // of a label, by first appearance
    for (int y = 0; y < labels.rows; ++y) {
        const int* row = labels.ptr<int>(y);
        for (int x = 0; x < labels.cols && mask.runs.size() < kMaxRuns;) {
            const int label = row[x];
            const int begin = x;
            while (x < labels.cols && row[x] == label) ++x;
            if (label == 0) continue;
            int& component = number[static_cast<std::size_t>(label)];
            if (component < 0) {
                component = static_cast<int>(mask.components.size());
                const std::int64_t area = stats.at<int>(label, cv::CC_STAT_AREA);
                const auto sum = [&](int axis) {
                    return std::llround(centroids.at<double>(label, axis) * static_cast<double>(area));
                };
                const int left = stats.at<int>(label, cv::CC_STAT_LEFT);
                const int top = stats.at<int>(label, cv::CC_STAT_TOP);
                mask.components.push_back({.area = area,
                                           .sum_x = sum(0),
                                           .sum_y = sum(1),
                                           .x0 = left,
                                           .y0 = top,
                                           .x1 = left + stats.at<int>(label, cv::CC_STAT_WIDTH),
                                           .y1 = top + stats.at<int>(label, cv::CC_STAT_HEIGHT)});
            }
            mask.runs.push_back({.y = y, .x0 = begin, .x1 = x, .component = component});
        }
    }
}

}  // namespace

void classify_opencv(const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks,
                     int opening) {
    masks.resize(cones.size());
    const Planes planes = normalise(image);
    cv::Mat taken = cv::Mat::zeros(image.height, image.width, CV_8U);
    for (std::size_t i = 0; i < cones.size(); ++i) {
        cv::Mat mask = mask_of(planes, cones[i]);
        mask.setTo(0, taken);  // of two cones that both contain a pixel, the first has it
        taken.setTo(255, mask);
        if (opening > 0) {
            const cv::Mat square = cv::getStructuringElement(cv::MORPH_RECT, {opening, opening});
            cv::morphologyEx(mask, mask, cv::MORPH_OPEN, square);
        }
        describe(mask, masks[i]);
    }
}

}  // namespace armsight::vision
