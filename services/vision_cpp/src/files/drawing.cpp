#include "files/drawing.hpp"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <vector>

namespace armsight::vision::files {
namespace {

constexpr int kShift = 4;  // OpenCV's sub-pixels: binary digits after the point
constexpr double kSubPixels = 16.0;
constexpr int kFont = cv::FONT_HERSHEY_SIMPLEX;
constexpr double kFontUnitPx = 22.0;  // height of that font at scale 1
constexpr int kTextMarginPx = 2;

cv::Scalar color_of(const foxglove::Color& color) { return {255.0 * color.r(), 255.0 * color.g(), 255.0 * color.b()}; }

int fixed(double pixels) { return static_cast<int>(std::lround(pixels * kSubPixels)); }

cv::Point fixed(const foxglove::Point2& point) { return {fixed(point.x()), fixed(point.y())}; }

int width_of(double thickness) { return std::max(1, static_cast<int>(std::lround(thickness))); }

void draw_points(const foxglove::PointsAnnotation& points, cv::Mat& image) {
    std::vector<cv::Point> pixels;
    for (const auto& point : points.points()) pixels.push_back(fixed(point));
    if (points.type() == foxglove::PointsAnnotation::LINE_LOOP) {
        cv::polylines(image, pixels, true, color_of(points.outline_color()), width_of(points.thickness()), cv::LINE_AA,
                      kShift);
        return;
    }
    for (const cv::Point& pixel : pixels) {
        cv::circle(image, pixel, fixed(points.thickness() / 2), color_of(points.outline_color()), cv::FILLED,
                   cv::LINE_AA, kShift);
    }
}

void draw_text(const foxglove::TextAnnotation& text, cv::Mat& image) {
    const double scale = text.font_size() / kFontUnitPx;
    int below = 0;
    const cv::Size size = cv::getTextSize(text.text(), kFont, scale, 1, &below);
    const cv::Point start(static_cast<int>(std::lround(text.position().x())),
                          static_cast<int>(std::lround(text.position().y())) + size.height / 2);
    const cv::Rect label(start.x - kTextMarginPx, start.y - size.height - kTextMarginPx, size.width + 2 * kTextMarginPx,
                         size.height + below + 2 * kTextMarginPx);
    const cv::Rect inside = label & cv::Rect({0, 0}, image.size());
    if (!inside.empty()) {
        cv::Mat under = image(inside);
        const double alpha = text.background_color().a();
        under.convertTo(under, -1, 1.0 - alpha, 0.0);
        under += alpha * color_of(text.background_color());
    }
    cv::putText(image, text.text(), start, kFont, scale, color_of(text.text_color()), 1, cv::LINE_AA);
}

}  // namespace

void draw(const foxglove::ImageAnnotations& annotations, Picture& picture) {
    cv::Mat image(picture.height, picture.width, CV_8UC3, picture.rgb.data());
    for (const auto& circle : annotations.circles()) {
        cv::circle(image, fixed(circle.position()), fixed(circle.diameter() / 2), color_of(circle.outline_color()),
                   width_of(circle.thickness()), cv::LINE_AA, kShift);
    }
    for (const auto& points : annotations.points()) draw_points(points, image);
    for (const auto& text : annotations.texts()) draw_text(text, image);
}

}  // namespace armsight::vision::files
