// The service's threads without a bus: one for each camera's images, one for what is told of the rig, one that counts
// for health, and the loop. Made for the thread sanitizer; tools/sanitize.sh runs it so.
#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "armsight/vision/pipeline.hpp"
#include "foxglove/RawImage.pb.h"
#include "scene.hpp"
#include "service/codec.hpp"
#include "service/counters.hpp"
#include "service/pairing.hpp"
#include "service/rig.hpp"

namespace armsight::vision::service {
namespace {

constexpr int kInstants = 60;
constexpr int kSize = 400;
constexpr std::int64_t kFramePeriodNs = 33'000'000;

std::string message_of(const testing::Picture& picture, std::int64_t capture_ns) {
    foxglove::RawImage message;
    message.mutable_timestamp()->set_seconds(capture_ns / 1'000'000'000);
    message.mutable_timestamp()->set_nanos(static_cast<std::int32_t>(capture_ns % 1'000'000'000));
    message.set_width(static_cast<std::uint32_t>(picture.width));
    message.set_height(static_cast<std::uint32_t>(picture.height));
    message.set_step(static_cast<std::uint32_t>(picture.step));
    message.set_encoding("rgb8");
    message.set_data(picture.bytes.data(), picture.bytes.size());
    return message.SerializeAsString();
}

testing::Scene arm() {
    testing::Scene scene;
    const auto markers = testing::arm_markers();
    const std::array<Eigen::Vector3d, 4> centres{
        {{0.0, 0.0, 0.85}, {0.1, 0.2, 4.8}, {1.4, -0.9, 7.1}, {3.1, 1.1, 8.0}}};
    for (std::size_t i = 0; i < markers.size(); ++i) {
        scene.spheres.push_back({centres.at(i), markers[i].radius, markers[i].color});
    }
    return scene;
}

// What the threads of the service share.
class Shared {
  public:
    Counters counters;
    Rig rig;
    std::mutex mutex;
    std::condition_variable arrived;
    Pairing pairing{{"1", "2"}};

    void take_image(const std::string& camera, std::shared_ptr<const std::string> bytes) {
        // NOLINTNEXTLINE(cppcoreguidelines-pro-type-reinterpret-cast): a string's characters are bytes
        const Bytes payload{reinterpret_cast<const std::uint8_t*>(bytes->data()), bytes->size()};
        const ImageMessage message = decode_image(payload);
        const auto checked =
            validate_image(message.data, message.width, message.height, message.step, message.encoding);
        const auto size = rig.size_of(camera);
        const auto* image = std::get_if<ImageView>(&checked);
        if (image == nullptr || (size && size->first != image->width)) {
            counters.add("refused");
            return;
        }
        counters.add("frames_received");
        {
            const std::scoped_lock lock(mutex);
            pairing.add({.camera = camera,
                         .capture_ns = message.capture_ns,
                         .sent_ns = 0,
                         .received_ns = 0,
                         .image = *image,
                         .owner = std::move(bytes)},
                        std::chrono::steady_clock::now());
        }
        arrived.notify_one();
    }
};

TEST(Threads, ImagesRigAndHealthComeWhileTheLoopMeasures) {
    const std::array<Camera, 2> cameras{testing::front_camera(kSize), testing::side_camera(kSize)};
    const std::array<testing::Picture, 2> pictures{testing::draw(arm(), cameras[0], 2),
                                                   testing::draw(arm(), cameras[1], 2)};
    Shared shared;
    std::atomic<bool> done{false};
    std::atomic<int> begun{0};  // the instant whose measurement began last
    const auto tell_rig = [&] {
        shared.rig.set({.markers = testing::arm_markers(), .cameras = {"1", "2"}});
        for (std::size_t i = 0; i < cameras.size(); ++i) {
            const std::string name = std::to_string(i + 1);
            shared.rig.set(name, Calibration{.width = kSize, .height = kSize, .K = cameras.at(i).K, .distortion = {}});
            shared.rig.set(name, cameras.at(i).T_world_camera);
        }
    };
    tell_rig();
    std::vector<std::jthread> threads;
    for (std::size_t i = 0; i < cameras.size(); ++i) {
        threads.emplace_back([&, i] {
            for (int instant = 1; instant <= kInstants; ++instant) {
                // one ahead: while the one before is measured, however slow this machine is
                while (begun < instant - 1 && !done) std::this_thread::sleep_for(std::chrono::milliseconds(1));
                shared.take_image(std::to_string(i + 1), std::make_shared<const std::string>(
                                                             message_of(pictures.at(i), instant * kFramePeriodNs)));
            }
        });
    }
    threads.emplace_back([&] {
        while (!done) {
            tell_rig();
            std::this_thread::sleep_for(std::chrono::milliseconds(1));
        }
    });
    threads.emplace_back([&] {
        while (!done) {
            (void)shared.counters.snapshot();
            (void)shared.rig.missing();
            std::this_thread::yield();
        }
    });

    Pipeline pipeline(testing::arm_markers());
    int answered = 0;
    for (const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(60);
         std::chrono::steady_clock::now() < until && shared.counters.snapshot()["done"] == 0;) {
        std::optional<Instant> instant;
        {
            std::unique_lock lock(shared.mutex);
            shared.arrived.wait_for(lock, std::chrono::milliseconds(20), [&] {
                instant = shared.pairing.take(std::chrono::steady_clock::now());
                return instant.has_value();
            });
        }
        if (!instant) continue;
        begun = static_cast<int>(instant->capture_ns / kFramePeriodNs);
        const auto known = shared.rig.cameras();
        std::vector<CameraFrame> frames;
        for (const Frame& frame : instant->frames) {
            frames.push_back({.camera = &known.at(frame.camera == "1" ? 0 : 1), .image = frame.image});
        }
        const auto& estimates = pipeline.process(instant->capture_ns, frames);
        EXPECT_NE(estimates.at(3).status, MarkerStatus::Lost);
        ++answered;
        if (instant->capture_ns == kInstants * kFramePeriodNs) shared.counters.add("done");
    }
    done = true;
    threads.clear();
    EXPECT_EQ(shared.counters.snapshot()["frames_received"], 2U * kInstants);
    EXPECT_EQ(answered, kInstants);
    EXPECT_EQ(shared.counters.snapshot()["refused"], 0U);
}

}  // namespace
}  // namespace armsight::vision::service
