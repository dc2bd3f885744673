// Counts what is taken from the heap: a program of its own, because it replaces operator new.
#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <cstdlib>
#include <new>
#include <vector>

#include "armsight/vision/pipeline.hpp"
#include "scene.hpp"

namespace {

// NOLINTNEXTLINE(cppcoreguidelines-avoid-non-const-global-variables): operator new has nowhere else to count
std::atomic<long> allocations{0};

void* counted(std::size_t size, std::size_t alignment) {
    ++allocations;
    // aligned_alloc wants whole multiples
    void* memory = std::aligned_alloc(alignment, (size + alignment - 1) / alignment * alignment);
    if (memory == nullptr) throw std::bad_alloc();
    return memory;
}

}  // namespace

void* operator new(std::size_t size) { return counted(size, alignof(std::max_align_t)); }
void* operator new(std::size_t size, std::align_val_t alignment) {
    return counted(size, static_cast<std::size_t>(alignment));
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t /*size*/) noexcept { std::free(memory); }
void operator delete(void* memory, std::align_val_t /*alignment*/) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t /*size*/, std::align_val_t /*alignment*/) noexcept { std::free(memory); }

namespace armsight::vision {
namespace {

constexpr int kInstants = 12;
constexpr std::int64_t kFramePeriodNs = 33'000'000;
const Eigen::Vector3d kOrange(0.9, 0.25, 0.0);

struct Instant {
    std::array<testing::Picture, 2> pictures;
};

// Four markers that move, one of them behind a link every third instant, one gone now and then; a box beside them.
std::vector<Instant> film(const std::array<Camera, 2>& cameras, bool with_box) {
    std::vector<Instant> result;
    const auto markers = testing::arm_markers();
    for (int i = 0; i < kInstants; ++i) {
        testing::Scene scene;
        const double t = 0.03 * i;
        const std::array<Eigen::Vector3d, 4> centres{
            {{0.0, 0.0, 0.85}, {0.1, 0.2 + t, 4.8}, {1.4, -0.9, 7.1 - t}, {3.1 - t, 1.1, 8.0}}};
        for (std::size_t k = 0; k < markers.size(); ++k) {
            if (k == 3 && i % 5 == 4) continue;
            scene.spheres.push_back({centres.at(k), markers[k].radius, markers[k].color});
        }
        if (i % 3 == 2) scene.capsules.push_back({{0.5, -2.0, 7.1}, {1.4, -2.0, 7.2}, 0.2});
        if (with_box) scene.cuboids.push_back({{-2.0, 0.0, 3.0 + t}, {0.4, 0.2, 0.2}, kOrange});
        result.push_back({{testing::draw(scene, cameras[0], 2), testing::draw(scene, cameras[1], 2)}});
    }
    return result;
}

long allocations_of(Pipeline& pipeline, const std::array<Camera, 2>& cameras, const std::vector<Instant>& film,
                    std::int64_t start_ns) {
    const long before = allocations;
    for (std::size_t i = 0; i < film.size(); ++i) {
        const std::array<CameraFrame, 2> frames{
            CameraFrame{.camera = cameras.data(), .image = film[i].pictures[0].view()},
            CameraFrame{.camera = &cameras[1], .image = film[i].pictures[1].view()}};
        (void)pipeline.process(start_ns + static_cast<std::int64_t>(i) * kFramePeriodNs, frames);
    }
    return allocations - before;
}

class Allocation : public ::testing::TestWithParam<bool> {};

TEST_P(Allocation, AFrameTakesNothingFromTheHeapOnceItsLikeWasSeen) {
    auto markers = testing::arm_markers();
    if (GetParam()) {
        markers.push_back({.name = "box", .radius = 0.0, .color = kOrange, .shape = Shape::Box});
    }
    const std::array<Camera, 2> cameras{testing::front_camera(), testing::side_camera()};
    const auto frames = film(cameras, GetParam());
    Pipeline pipeline(markers);
    EXPECT_GT(allocations_of(pipeline, cameras, frames, 0), 0) << "the first frames fill the pool: is this counted?";
    EXPECT_EQ(allocations_of(pipeline, cameras, frames, kInstants * kFramePeriodNs), 0);
}

INSTANTIATE_TEST_SUITE_P(Scenes, Allocation, ::testing::Values(false, true));

}  // namespace
}  // namespace armsight::vision
