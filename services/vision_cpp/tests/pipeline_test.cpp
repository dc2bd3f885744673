#include "armsight/vision/pipeline.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <random>
#include <stdexcept>
#include <string>

#include "armsight/vision/opencv_classify.hpp"
#include "scene.hpp"

namespace armsight::vision {
namespace {

using testing::Picture;
using testing::Scene;

constexpr std::int64_t kFrame = 33'333'333;

// The arm's markers at a pose, without links.
Scene arm() {
    Scene scene;
    const std::vector<Eigen::Vector3d> centres{{0.0, 0.0, 0.85}, {0.1, 0.2, 4.8}, {1.4, -0.9, 7.1}, {3.1, 1.1, 8.0}};
    const auto markers = testing::arm_markers();
    for (std::size_t i = 0; i < markers.size(); ++i) {
        scene.spheres.push_back({centres[i], markers[i].radius, markers[i].color});
    }
    return scene;
}

struct Rig {
    std::vector<Camera> cameras{testing::front_camera(), testing::side_camera()};
    Pipeline pipeline{testing::arm_markers()};

    std::vector<MarkerEstimate> process(const std::vector<Picture>& pictures, std::int64_t capture_ns) {
        std::vector<CameraFrame> frames;
        frames.reserve(pictures.size());
        for (std::size_t i = 0; i < pictures.size(); ++i) {
            frames.push_back({.camera = &cameras[i], .image = pictures[i].view()});
        }
        return pipeline.process(capture_ns, frames);
    }
    std::vector<MarkerEstimate> look(const Scene& scene, std::int64_t capture_ns, double noise = 0.0) {
        std::vector<Picture> pictures;
        for (const Camera& camera : cameras) {
            pictures.push_back(testing::draw(scene, camera, 4));
            if (noise > 0.0) pictures.back() = testing::with_noise(pictures.back(), noise, 29);
        }
        return process(pictures, capture_ns);
    }
};

double error(const MarkerEstimate& estimate, const Scene& scene, std::size_t marker) {
    return estimate.position ? (*estimate.position - scene.spheres[marker].centre).norm() : 1e9;
}

TEST(Pipeline, OpenCvAsBackendGivesTheSameToTheLastBit) {
    const Scene scene = arm();
    Rig ours;
    Rig theirs{.pipeline = Pipeline(testing::arm_markers(),
                                    [](const ImageView& image, std::span<const ColorCone> cones,
                                       std::vector<MarkerMask>& masks) { classify_opencv(image, cones, masks); })};
    const auto expected = ours.look(scene, kFrame, 4.0);
    const auto found = theirs.look(scene, kFrame, 4.0);
    ASSERT_EQ(found.size(), expected.size());
    for (std::size_t i = 0; i < found.size(); ++i) {
        ASSERT_TRUE(found[i].position && expected[i].position);
        EXPECT_EQ(*found[i].position, *expected[i].position);
        EXPECT_EQ(found[i].covariance, expected[i].covariance);
        EXPECT_EQ(found[i].status, expected[i].status);
    }
}

TEST(Pipeline, FreeMarkersAreTrackedToAFewMillimetres) {
    Rig rig;
    const Scene scene = arm();
    const auto estimates = rig.look(scene, kFrame);
    ASSERT_EQ(estimates.size(), 4U);
    for (std::size_t i = 0; i < 4; ++i) {
        EXPECT_EQ(estimates[i].status, MarkerStatus::Tracked) << estimates[i].name;
        EXPECT_LT(error(estimates[i], scene, i), 0.004) << estimates[i].name;
        EXPECT_EQ(estimates[i].observations.size(), 2U);
        EXPECT_GT(estimates[i].covariance.determinant(), 0.0);
    }
}

TEST(Pipeline, ObservationsAreInTheWiresPixels) {
    Rig rig;
    const Scene scene = arm();
    for (const MarkerEstimate& estimate : rig.look(scene, kFrame)) {
        for (std::size_t c = 0; c < 2; ++c) {
            const Camera& camera = rig.cameras[c];
            const Eigen::Vector3d point = camera.T_world_camera.inverse() * *estimate.position;
            const Eigen::Vector3d pixel = camera.K * point / point.z();  // OpenCV's convention, as K's
            EXPECT_NEAR(estimate.observations[c].u, pixel.x(), 0.1);
            EXPECT_NEAR(estimate.observations[c].v, pixel.y(), 0.1);
        }
    }
}

TEST(Pipeline, SensorNoiseCostsMillimetres) {
    Rig rig;
    const Scene scene = arm();
    const auto estimates = rig.look(scene, kFrame, 4.0);
    for (std::size_t i = 0; i < 4; ++i) EXPECT_LT(error(estimates[i], scene, i), 0.015) << estimates[i].name;
}

TEST(Pipeline, HalfHiddenMarkersAreSaidToBeAndStayExact) {
    Rig rig;
    Scene scene = arm();
    // in front of blue for camera 1, hiding its left half
    scene.capsules.push_back({{5.0, -1.0, 5.0}, {5.0, -1.0, 9.0}, 0.3});
    const auto estimates = rig.look(scene, kFrame);
    EXPECT_EQ(estimates[2].status, MarkerStatus::PartlyOccluded);
    EXPECT_LT(estimates[2].observations[0].visible, 0.8);
    EXPECT_LT(error(estimates[2], scene, 2), 0.03);
}

TEST(Pipeline, MarkerHiddenInOneViewComesFromTheOtherWithACovarianceThatSaysSo) {
    Rig rig;
    Scene scene = arm();
    (void)rig.look(scene, kFrame);
    scene.capsules.push_back({{5.0, -0.65, 6.0}, {5.0, -0.65, 8.5}, 0.7});
    const auto estimates = rig.look(scene, 2 * kFrame);
    EXPECT_EQ(estimates[2].status, MarkerStatus::OneView);
    ASSERT_EQ(estimates[2].observations.size(), 1U);
    EXPECT_EQ(estimates[2].observations[0].camera, "2");
    const Eigen::Vector3d off = *estimates[2].position - scene.spheres[2].centre;
    EXPECT_LT(off.norm(), 0.3);
    // camera 2 looks along y: that is where it knows least, and it must not claim more than it knows
    EXPECT_GT(estimates[2].covariance(1, 1), estimates[2].covariance(0, 0));
    EXPECT_LT(off.dot(estimates[2].covariance.inverse() * off), 16.0);
}

TEST(Pipeline, MarkerHiddenInBothViewsIsLostAtItsLastPosition) {
    Rig rig;
    Scene scene = arm();
    const auto before = rig.look(scene, kFrame);
    scene.spheres.erase(scene.spheres.begin() + 2);
    const auto after = rig.look(scene, 4 * kFrame);
    EXPECT_EQ(after[2].status, MarkerStatus::Lost);
    EXPECT_EQ(*after[2].position, *before[2].position);
    EXPECT_NEAR(after[2].age_s, 3 * kFrame * 1e-9, 1e-12);
    EXPECT_GT(after[2].covariance(0, 0), 0.01);
    EXPECT_TRUE(after[2].observations.empty());
}

TEST(Pipeline, MarkerThatWasNeverSeenHasNoPosition) {
    Rig rig;
    Scene scene = arm();
    scene.spheres.erase(scene.spheres.begin() + 3);
    const auto estimates = rig.look(scene, kFrame);
    EXPECT_EQ(estimates[3].status, MarkerStatus::Lost);
    EXPECT_FALSE(estimates[3].position);
}

TEST(Pipeline, TheSameInstantAgainGetsTheSameAnswer) {
    Rig rig;
    Scene scene = arm();
    (void)rig.look(scene, kFrame);
    const auto first = rig.look(scene, 2 * kFrame);
    scene.spheres[3].centre.x() += 1.0;  // what the pixels say now does not matter: the instant was answered
    const auto again = rig.look(scene, 2 * kFrame);
    for (std::size_t i = 0; i < 4; ++i) EXPECT_EQ(*first[i].position, *again[i].position);
}

TEST(Pipeline, ATimeThatGoesBackBeginsAnew) {
    Rig rig;
    Scene scene = arm();
    (void)rig.look(scene, 100 * kFrame);
    scene.spheres.pop_back();
    const auto estimates = rig.look(scene, kFrame);
    EXPECT_FALSE(estimates[3].position) << "remembered from another run";
}

TEST(Pipeline, ThreeCamerasOfDifferentSizesWork) {
    Rig rig;
    rig.cameras = {testing::front_camera(640), testing::side_camera(480),
                   testing::camera_at({12.0, 12.0, 10.0}, {0.0, 0.0, 5.0}, 900, 700, 600.0)};
    rig.cameras[2].name = "3";
    const Scene scene = arm();
    const auto estimates = rig.look(scene, kFrame);
    for (std::size_t i = 0; i < 4; ++i) {
        EXPECT_EQ(estimates[i].observations.size(), 3U);
        EXPECT_LT(error(estimates[i], scene, i), 0.006) << estimates[i].name;
    }
}

TEST(Pipeline, FramesThatCannotBeMeasuredAreLeftOut) {
    Rig rig;
    const Scene scene = arm();
    const std::vector<Picture> pictures{testing::draw(scene, rig.cameras[0], 4),
                                        testing::draw(scene, testing::side_camera(400), 4)};
    const auto estimates = rig.process(pictures, kFrame);
    EXPECT_EQ(estimates[0].status, MarkerStatus::OneView);
    EXPECT_TRUE(rig.process({}, 2 * kFrame)[0].observations.empty());
}

// How far the truth lies from an estimate, in its own standard deviations.
double deviations(const MarkerEstimate& estimate, const Eigen::Vector3d& truth) {
    const Eigen::Vector3d off = *estimate.position - truth;
    return std::sqrt(off.dot(estimate.covariance.inverse() * off));
}

TEST(Pipeline, FreeMarkersAtRandomPlacesAreTrackedToAFewMillimetres) {
    constexpr unsigned kSeed = 2024;
    std::mt19937 generator(kSeed);
    std::uniform_real_distribution<double> off(-0.4, 0.4);
    Rig rig;
    for (int i = 1; i <= 4; ++i) {
        Scene scene = arm();
        for (auto& sphere : scene.spheres) {
            sphere.centre += Eigen::Vector3d(off(generator), off(generator), off(generator));
        }
        const auto estimates = rig.look(scene, i * kFrame);
        for (std::size_t m = 0; m < 4; ++m) {
            const std::string trace =
                estimates[m].name + " seed " + std::to_string(kSeed) + " place " + std::to_string(i);
            EXPECT_LT(error(estimates[m], scene, m), 0.005) << trace;
            ASSERT_TRUE(estimates[m].position) << trace;
            EXPECT_LT(deviations(estimates[m], scene.spheres[m].centre), 4.0) << trace;
        }
    }
}

TEST(Pipeline, MarkerThatMovesWhileOneViewIsHiddenStaysWithinItsCovariance) {
    Rig rig;
    Scene scene = arm();
    (void)rig.look(scene, kFrame);
    scene.capsules.push_back({{5.0, -0.65, 6.0}, {5.0, -0.65, 8.5}, 0.8});
    for (int i = 2; i <= 5; ++i) {
        scene.spheres[2].centre += Eigen::Vector3d(0.05, 0.03, -0.04);  // 2 m/s
        const auto estimates = rig.look(scene, i * kFrame);
        ASSERT_EQ(estimates[2].status, MarkerStatus::OneView) << "frame " << i;
        EXPECT_LT(deviations(estimates[2], scene.spheres[2].centre), 4.0) << "frame " << i;
        // across the line of sight (y) one view is as good as two
        EXPECT_NEAR(estimates[2].position->x(), scene.spheres[2].centre.x(), 0.02);
        EXPECT_NEAR(estimates[2].position->z(), scene.spheres[2].centre.z(), 0.02);
    }
}

TEST(Pipeline, MarkerThatOnlyOneCameraEverSawIsMeasuredByItsRadius) {
    Rig rig;
    Scene scene = arm();
    scene.capsules.push_back({{5.0, -0.65, 6.0}, {5.0, -0.65, 8.5}, 0.8});
    const auto estimates = rig.look(scene, kFrame);
    EXPECT_EQ(estimates[2].status, MarkerStatus::OneView);
    ASSERT_TRUE(estimates[2].position);
    EXPECT_LT(deviations(estimates[2], scene.spheres[2].centre), 4.0);
    EXPECT_GT(estimates[2].covariance(1, 1), 20.0 * estimates[2].covariance(0, 0)) << "depth is weak";
}

TEST(Pipeline, MarkerThatComesBackIsTrackedAgainAtOnce) {
    Rig rig;
    Scene scene = arm();
    (void)rig.look(scene, kFrame);
    Scene without = scene;
    without.spheres.erase(without.spheres.begin() + 2);
    EXPECT_EQ(rig.look(without, 2 * kFrame)[2].status, MarkerStatus::Lost);
    scene.spheres[2].centre += Eigen::Vector3d(0.5, 0.5, -0.5);
    const auto estimates = rig.look(scene, 3 * kFrame);
    EXPECT_EQ(estimates[2].status, MarkerStatus::Tracked);
    EXPECT_LT(error(estimates[2], scene, 2), 0.005);
    EXPECT_EQ(estimates[2].age_s, 0.0);
}

TEST(Pipeline, ResetForgetsEverything) {
    Rig rig;
    (void)rig.look(arm(), kFrame);
    rig.pipeline.reset();
    for (const MarkerEstimate& estimate : rig.process({}, 2 * kFrame)) {
        EXPECT_EQ(estimate.status, MarkerStatus::Lost);
        EXPECT_FALSE(estimate.position);
        EXPECT_EQ(estimate.age_s, 0.0);
    }
}

TEST(Pipeline, SamePicturesGiveTheSameBitsInAnyOrderOfChannels) {
    const Scene scene = arm();
    Rig first;
    std::vector<Picture> pictures;
    for (const Camera& camera : first.cameras) pictures.push_back(testing::draw(scene, camera, 2));
    const auto expected = first.process(pictures, kFrame);
    for (const PixelFormat format : {PixelFormat::Rgb8, PixelFormat::Bgr8, PixelFormat::Rgba8, PixelFormat::Bgra8}) {
        Rig rig;
        std::vector<Picture> others;
        for (const Picture& picture : pictures) others.push_back(testing::converted(picture, format, 12));
        const auto estimates = rig.process(others, kFrame);
        for (std::size_t i = 0; i < 4; ++i) {
            EXPECT_EQ(*estimates[i].position, *expected[i].position);
            EXPECT_EQ(estimates[i].covariance, expected[i].covariance);
        }
    }
}

TEST(Pipeline, FramesWithoutAUsableCameraAreLeftOut) {
    Rig rig;
    const Picture picture = testing::draw(arm(), rig.cameras[0], 1);
    Camera broken = rig.cameras[1];
    broken.T_world_camera.translation().y() = std::numeric_limits<double>::quiet_NaN();
    const CameraFrame whole{.camera = rig.cameras.data(), .image = picture.view()};
    const CameraFrame nobody{.camera = nullptr, .image = picture.view()};
    const CameraFrame unusable{.camera = &broken, .image = picture.view()};
    EXPECT_TRUE(is_measurable(whole));
    EXPECT_FALSE(is_measurable(nobody));
    EXPECT_FALSE(is_measurable(unusable));
    const auto estimates = rig.pipeline.process(kFrame, std::vector<CameraFrame>{nobody, whole, unusable});
    for (const MarkerEstimate& estimate : estimates) {
        ASSERT_EQ(estimate.observations.size(), 1U) << estimate.name;
        EXPECT_EQ(estimate.observations[0].camera, "1");
    }
}

TEST(Pipeline, MarkersThatCannotBeToldApartAreRefused) {
    auto markers = testing::arm_markers();
    markers[1].color = markers[0].color;
    EXPECT_THROW((void)Pipeline(markers), std::invalid_argument);
}

TEST(Pipeline, LargerPatchOfItsColourInOneViewDoesNotLoseAMarkerWhosePlaceIsKnown) {
    Rig rig;
    const Scene scene = arm();
    (void)rig.look(scene, kFrame);
    Scene with_other = scene;
    with_other.spheres.push_back({{0.0, -4.0, 4.0}, 0.6, {1.0, 0.0, 0.0}});
    const auto estimates =
        rig.process({testing::draw(with_other, rig.cameras[0]), testing::draw(scene, rig.cameras[1])}, 2 * kFrame);
    EXPECT_NE(estimates[3].status, MarkerStatus::Lost) << "both cameras see it";
    EXPECT_LT(error(estimates[3], scene, 3), 0.3);
}

}  // namespace
}  // namespace armsight::vision
