#include "armsight/vision/track.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace armsight::vision {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;

TEST(Track, NothingIsPredictedOfWhatWasNeverSeen) {
    const Track track;
    EXPECT_FALSE(track.predict(kSecond));
    EXPECT_EQ(track.age_s(kSecond), 0.0);
}

TEST(Track, UncertaintyGrowsWithTimeAndEnds) {
    Track track;
    const Eigen::Matrix3d seen = 1e-6 * Eigen::Matrix3d::Identity();
    track.update(10 * kSecond, {1.0, 2.0, 3.0}, seen);
    EXPECT_EQ(track.predict(10 * kSecond)->covariance, seen);
    double before = 0.0;
    for (const double later_s : {0.1, 0.5, 1.5}) {
        const auto later = 10 * kSecond + static_cast<std::int64_t>(later_s * kSecond);
        const auto prior = track.predict(later);
        EXPECT_EQ(prior->position, Eigen::Vector3d(1.0, 2.0, 3.0));
        EXPECT_GT(prior->covariance(0, 0), before);
        before = prior->covariance(0, 0);
        EXPECT_DOUBLE_EQ(track.age_s(later), later_s);
    }
    EXPECT_EQ(track.predict(1000 * kSecond)->covariance, track.predict(2000 * kSecond)->covariance);
}

TEST(Track, LatestUpdateIsWhatIsRemembered) {
    Track track;
    track.update(kSecond, {1.0, 2.0, 3.0}, Eigen::Matrix3d::Identity());
    track.update(2 * kSecond, {4.0, 5.0, 6.0}, 1e-6 * Eigen::Matrix3d::Identity());
    EXPECT_EQ(track.predict(2 * kSecond)->position, Eigen::Vector3d(4.0, 5.0, 6.0));
    EXPECT_EQ(track.predict(2 * kSecond)->covariance(0, 0), 1e-6);
    EXPECT_EQ(track.age_s(3 * kSecond), 1.0);
}

TEST(Track, UncertaintyAllowsForTheFastestMarker) {
    // the tip at 6 m from the shoulder, a joint at 1 rad/s: 6 m/s, and no more than the workspace is wide
    Track track;
    track.update(0, {0.0, 0.0, 0.0}, Eigen::Matrix3d::Zero());
    const auto sigma = [&](double s) {
        return std::sqrt(track.predict(static_cast<std::int64_t>(s * 1e9))->covariance(1, 1));
    };
    EXPECT_GE(sigma(0.1), 0.6 * (1 - 1e-12));
    EXPECT_LE(sigma(100.0), 12.0 + 1e-12);
}

}  // namespace
}  // namespace armsight::vision
