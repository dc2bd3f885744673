#include "armsight/vision/track.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>
#include <random>

namespace armsight::vision {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kFrame = kSecond / 30;
const Eigen::Matrix3d kSharp = 1e-6 * Eigen::Matrix3d::Identity();

Fix fix(const Eigen::Vector3d& position, const Eigen::Matrix3d& covariance = kSharp) {
    return {.position = position, .covariance = covariance, .sigma_px = 0.1, .inliers = 40};
}

double d2(const Prior& prior, const Eigen::Vector3d& truth) {
    const Eigen::Vector3d apart = truth - prior.position;
    return apart.dot(prior.covariance.ldlt().solve(apart));
}

TEST(Track, NothingIsPredictedOfWhatWasNeverSeen) {
    const Track track;
    EXPECT_FALSE(track.predict(kSecond));
    EXPECT_EQ(track.age_s(kSecond), 0.0);
}

TEST(Track, SeenOnceItMayHaveGoneAnywhereThatTheFastestMarkerReaches) {
    Track track;
    track.update(10 * kSecond, fix({1.0, 2.0, 3.0}));
    EXPECT_EQ(track.predict(10 * kSecond)->position, Eigen::Vector3d(1.0, 2.0, 3.0));
    EXPECT_TRUE(track.predict(10 * kSecond)->covariance.isApprox(kSharp));
    double before = 0.0;
    for (const double later_s : {0.1, 0.5, 1.5}) {
        const auto later = 10 * kSecond + static_cast<std::int64_t>(later_s * kSecond);
        const auto prior = track.predict(later);
        EXPECT_EQ(prior->position, Eigen::Vector3d(1.0, 2.0, 3.0));
        EXPECT_GE(std::sqrt(prior->covariance(1, 1)), 6.0 * later_s);
        EXPECT_GT(prior->covariance(0, 0), before);
        before = prior->covariance(0, 0);
        EXPECT_DOUBLE_EQ(track.age_s(later), later_s);
    }
    EXPECT_EQ(track.predict(1000 * kSecond)->covariance, track.predict(2000 * kSecond)->covariance);
}

// Markers of the arm's test motions, measured with 3 mm of noise.
TEST(Track, PredictsASwingToMillimetresAndKnowsHowWell) {
    constexpr unsigned kSeed = 12;
    std::mt19937 generator(kSeed);
    std::normal_distribution<double> noise(0.0, 0.003);
    const auto truth = [](double t) {
        const double angle = 3.1 * std::sin(3.14159 * t / 14.0);
        return Eigen::Vector3d(5.0 * std::cos(angle), 5.0 * std::sin(angle), 4.0 + 2.0 * std::sin(0.3 * t));
    };
    Track track;
    int outside = 0;
    double worst = 0.0;
    for (int i = 0; i < 900; ++i) {
        const double t = i / 30.0;
        if (i > 5) {
            const auto prior = track.predict(i * kFrame);
            worst = std::max(worst, (prior->position - truth(t)).norm());
            outside += d2(*prior, truth(t)) > 11.3 ? 1 : 0;  // 99 %
        }
        const Eigen::Vector3d measured =
            truth(t) + Eigen::Vector3d(noise(generator), noise(generator), noise(generator));
        track.update(i * kFrame, fix(measured, 9e-6 * Eigen::Matrix3d::Identity()));
    }
    EXPECT_LT(worst, 0.025) << "seed " << kSeed;
    EXPECT_LT(outside, 20) << "seed " << kSeed;
}

TEST(Track, CarriesOnAMomentAndThenOnlyDoubts) {
    Track track;
    for (int i = 0; i < 30; ++i) track.update(i * kFrame, fix({0.1 * i, 0.0, 0.0}));  // 3 m/s
    const auto soon = track.predict(32 * kFrame);
    EXPECT_NEAR(soon->position.x(), 3.2, 0.02);
    const auto late = track.predict(29 * kFrame + 10 * kSecond);
    EXPECT_NEAR(late->position.x(), 2.9 + 0.9, 0.05);
    EXPECT_GT(std::sqrt(late->covariance(0, 0)), 5.0);
}

TEST(Track, JumpStartsAnew) {
    Track track;
    for (int i = 0; i < 10; ++i) track.update(i * kFrame, fix({0.1 * i, 0.0, 0.0}));
    track.update(10 * kFrame, fix({-3.0, 4.0, 5.0}));
    EXPECT_EQ(track.predict(10 * kFrame)->position, Eigen::Vector3d(-3.0, 4.0, 5.0));
    const auto next = track.predict(11 * kFrame);
    EXPECT_EQ(next->position, Eigen::Vector3d(-3.0, 4.0, 5.0)) << "the old velocity is not the new one's";
    EXPECT_GT(std::sqrt(next->covariance(0, 0)), 0.15);
}

TEST(Track, WhatHasThePastInItIsNotCountedTwice) {
    Track once;
    Track twice;
    for (int i = 0; i < 10; ++i) {
        once.update(i * kFrame, fix({0.0, 0.0, 0.0}));
        twice.update(i * kFrame, fix({0.0, 0.0, 0.0}));
    }
    // a measurement of no worth leaves what was predicted; given as the sum of both, it must stay exactly that
    const Prior prior = *once.predict(10 * kFrame);
    once.update(10 * kFrame, fix(prior.position, 1e6 * Eigen::Matrix3d::Identity()));
    Fix joint = fix(prior.position, prior.covariance);
    joint.has_prior = true;
    twice.update(10 * kFrame, joint);
    EXPECT_TRUE(once.predict(15 * kFrame)->covariance.isApprox(twice.predict(15 * kFrame)->covariance, 1e-4));
    EXPECT_TRUE(once.predict(10 * kFrame)->covariance.isApprox(prior.covariance, 1e-4));
}

}  // namespace
}  // namespace armsight::vision
