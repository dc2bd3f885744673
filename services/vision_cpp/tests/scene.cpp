#include "scene.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

namespace armsight::vision::testing {
namespace {

constexpr double kNothing = std::numeric_limits<double>::infinity();

double hit_sphere(const Eigen::Vector3d& origin, const Eigen::Vector3d& d, const Eigen::Vector3d& centre, double r) {
    const Eigen::Vector3d to = centre - origin;
    const double along = to.dot(d);
    const double across2 = to.squaredNorm() - along * along;
    if (across2 > r * r || along < 0.0) return kNothing;
    return along - std::sqrt(r * r - across2);
}

double hit_capsule(const Eigen::Vector3d& origin, const Eigen::Vector3d& d, const Capsule& capsule) {
    const double ends = std::min(hit_sphere(origin, d, capsule.start, capsule.radius),
                                 hit_sphere(origin, d, capsule.end, capsule.radius));
    const Eigen::Vector3d axis = (capsule.end - capsule.start).normalized();
    const Eigen::Vector3d d_across = d - d.dot(axis) * axis;
    const Eigen::Vector3d o_across = origin - capsule.start - (origin - capsule.start).dot(axis) * axis;
    const double a = d_across.squaredNorm();
    const double b = d_across.dot(o_across);
    const double c = o_across.squaredNorm() - capsule.radius * capsule.radius;
    const double discriminant = b * b - a * c;
    if (a < 1e-12 || discriminant < 0.0) return ends;
    const double t = (-b - std::sqrt(discriminant)) / a;
    const double along = (origin + t * d - capsule.start).dot(axis);
    const bool on_side = t > 0.0 && along >= 0.0 && along <= (capsule.end - capsule.start).norm();
    return on_side ? std::min(ends, t) : ends;
}

// Where the ray enters, and through which side.
double hit_cuboid(const Eigen::Vector3d& origin, const Eigen::Vector3d& d, const Cuboid& cuboid, int& side) {
    double enter = -kNothing;
    double leave = kNothing;
    for (int i = 0; i < 3; ++i) {
        const double a = (cuboid.centre[i] - cuboid.half[i] - origin[i]) / d[i];
        const double b = (cuboid.centre[i] + cuboid.half[i] - origin[i]) / d[i];
        if (std::min(a, b) > enter) {
            enter = std::min(a, b);
            side = i;
        }
        leave = std::min(leave, std::max(a, b));
    }
    return enter < leave && enter > 0.0 ? enter : kNothing;
}

Eigen::Vector3d color_of(const Scene& scene, const Eigen::Vector3d& origin, const Eigen::Vector3d& d) {
    double nearest = kNothing;
    Eigen::Vector3d color = Eigen::Vector3d::Constant(scene.background);
    const Eigen::Vector3d light = Eigen::Vector3d(1.0, -1.0, 2.0).normalized();
    for (const Sphere& sphere : scene.spheres) {
        const double t = hit_sphere(origin, d, sphere.centre, sphere.radius);
        if (t >= nearest) continue;
        nearest = t;
        const Eigen::Vector3d normal = (origin + t * d - sphere.centre) / sphere.radius;
        color = sphere.color * (0.5 + 0.4 * std::max(0.0, normal.dot(light)));
    }
    for (const Cuboid& cuboid : scene.cuboids) {
        int side = 0;
        const double t = hit_cuboid(origin, d, cuboid, side);
        if (t >= nearest) continue;
        nearest = t;
        color = cuboid.color * (0.5 + 0.13 * side);
    }
    for (const Capsule& capsule : scene.capsules) {
        const double t = hit_capsule(origin, d, capsule);
        if (t >= nearest) continue;
        nearest = t;
        color.setZero();
    }
    return color;
}

std::uint8_t grey_level(double value) {
    return static_cast<std::uint8_t>(std::clamp(std::lround(255.0 * value), 0L, 255L));
}

}  // namespace

Picture draw(const Scene& scene, const Camera& camera, int oversampling) {
    const int step = camera.width * 3;
    Picture picture{.bytes = std::vector<std::uint8_t>(static_cast<std::size_t>(step * camera.height)),
                    .width = camera.width,
                    .height = camera.height,
                    .step = step,
                    .format = PixelFormat::Rgb8};
    const Eigen::Matrix3d inverse_K = camera.K.inverse();
    const Eigen::Vector3d origin = camera.T_world_camera.translation();
    for (int y = 0; y < camera.height; ++y) {
        for (int x = 0; x < camera.width; ++x) {
            Eigen::Vector3d sum = Eigen::Vector3d::Zero();
            for (int i = 0; i < oversampling * oversampling; ++i) {
                // integer coordinates are pixel centres here: the pixel reaches half to each side
                const double u = x - 0.5 + (i % oversampling + 0.5) / oversampling;
                const double v = y - 0.5 + (i / oversampling + 0.5) / oversampling;
                const Eigen::Vector3d d = (inverse_K * Eigen::Vector3d(u, v, 1.0)).normalized();
                sum += color_of(scene, origin, camera.T_world_camera.linear() * d);
            }
            sum /= oversampling * oversampling;
            for (int c = 0; c < 3; ++c) {
                picture.bytes[static_cast<std::size_t>(y * step + x * 3 + c)] = grey_level(sum[c]);
            }
        }
    }
    return picture;
}

Picture with_noise(Picture picture, double sigma, unsigned seed) {
    std::mt19937 generator(seed);
    std::normal_distribution<double> noise(0.0, sigma);
    for (std::uint8_t& byte : picture.bytes) byte = grey_level((byte + noise(generator)) / 255.0);
    return picture;
}

Picture converted(const Picture& picture, PixelFormat format, int padding) {
    const PixelLayout to = layout(format);
    Picture result{.bytes = {},
                   .width = picture.width,
                   .height = picture.height,
                   .step = picture.width * to.size + padding,
                   .format = format};
    result.bytes.assign(static_cast<std::size_t>(result.step * picture.height), 0xAB);
    for (int y = 0; y < picture.height; ++y) {
        for (int x = 0; x < picture.width; ++x) {
            const std::uint8_t* from = picture.bytes.data() + y * picture.step + x * 3;
            std::uint8_t* pixel = result.bytes.data() + y * result.step + x * to.size;
            pixel[to.red] = from[0];
            pixel[to.green] = from[1];
            pixel[to.blue] = from[2];
        }
    }
    return result;
}

Camera camera_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target, int width, int height, double focal) {
    Camera camera{.name = "camera",
                  .width = width,
                  .height = height,
                  .K = Eigen::Matrix3d::Identity(),
                  .distortion = {},
                  .T_world_camera = Eigen::Isometry3d::Identity()};
    camera.K(0, 0) = camera.K(1, 1) = focal;
    camera.K(0, 2) = (width - 1) / 2.0;
    camera.K(1, 2) = (height - 1) / 2.0;
    const Eigen::Vector3d z = (target - eye).normalized();
    const Eigen::Vector3d x = z.cross(Eigen::Vector3d::UnitZ()).normalized();
    camera.T_world_camera.linear().col(0) = x;
    camera.T_world_camera.linear().col(1) = z.cross(x);
    camera.T_world_camera.linear().col(2) = z;
    camera.T_world_camera.translation() = eye;
    return camera;
}

Camera front_camera(int size) {
    const double focal = size / 2.0 / std::tan(40.0 * std::numbers::pi / 180.0);
    Camera camera = camera_at({18.0, 0.0, 6.0}, {0.0, 0.0, 6.0}, size, size, focal);
    camera.name = "1";
    return camera;
}

Camera side_camera(int size) {
    const double focal = size / 2.0 / std::tan(40.0 * std::numbers::pi / 180.0);
    Camera camera = camera_at({0.0, -18.0, 6.0}, {0.0, 0.0, 6.0}, size, size, focal);
    camera.name = "2";
    return camera;
}

std::vector<MarkerModel> arm_markers() {
    return {{.name = "green", .radius = 0.7, .color = {0.0, 1.0, 0.0}},
            {.name = "yellow", .radius = 0.6, .color = {1.0, 1.0, 0.0}},
            {.name = "blue", .radius = 0.4, .color = {0.0, 0.0, 1.0}},
            {.name = "red", .radius = 0.3, .color = {1.0, 0.0, 0.0}}};
}

}  // namespace armsight::vision::testing
