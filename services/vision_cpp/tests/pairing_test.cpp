#include "service/pairing.hpp"

#include <gtest/gtest.h>

namespace armsight::vision::service {
namespace {

using std::chrono::milliseconds;

const SteadyTime kStart{};

Frame frame(const std::string& camera, std::int64_t capture_ns, std::uint64_t sent_ns = 0) {
    return {.camera = camera, .capture_ns = capture_ns, .sent_ns = sent_ns, .received_ns = 0, .image = {}, .owner = {}};
}

TEST(Pairing, InstantIsGivenOutWhenItsLastFrameIsThere) {
    Pairing pairing({"1", "2"});
    pairing.add(frame("2", 10), kStart);
    EXPECT_FALSE(pairing.take(kStart));
    pairing.add(frame("1", 10), kStart);
    const auto instant = pairing.take(kStart);
    ASSERT_TRUE(instant);
    EXPECT_EQ(instant->capture_ns, 10);
    ASSERT_EQ(instant->frames.size(), 2U);
    EXPECT_EQ(instant->frames[0].camera, "1") << "in the order of names, whatever came first";
    EXPECT_FALSE(pairing.take(kStart));
}

TEST(Pairing, FramesOfDifferentInstantsAreNeverPaired) {
    Pairing pairing({"1", "2"});
    pairing.add(frame("1", 10), kStart);
    pairing.add(frame("2", 11), kStart);
    EXPECT_FALSE(pairing.take(kStart));
}

TEST(Pairing, LostFrameCostsItsInstantAndNoOther) {
    Pairing pairing({"1", "2"});
    pairing.add(frame("1", 10), kStart);
    pairing.add(frame("1", 11), kStart + milliseconds{33});
    pairing.add(frame("2", 11), kStart + milliseconds{33});
    EXPECT_EQ(pairing.take(kStart + milliseconds{34})->capture_ns, 11);
    EXPECT_EQ(pairing.dropped(), 1U);
    EXPECT_FALSE(pairing.take(kStart + milliseconds{500}));
}

TEST(Pairing, WhatStaysIncompleteIsGivenOutInTheEnd) {
    Pairing pairing({"1", "2"});
    pairing.add(frame("1", 10), kStart);
    EXPECT_FALSE(pairing.take(kStart + Pairing::kPatience - milliseconds{1}));
    const auto instant = pairing.take(kStart + Pairing::kPatience);
    ASSERT_TRUE(instant);
    EXPECT_EQ(instant->frames.size(), 1U);
}

TEST(Pairing, CameraThatIsGoneIsNotWaitedForUntilItIsBack) {
    Pairing pairing({"1", "2"});
    SteadyTime now = kStart;
    for (int i = 0; i < Pairing::kMissesUntilGone; ++i) {
        pairing.add(frame("1", i), now);
        now += Pairing::kPatience;
        ASSERT_TRUE(pairing.take(now));
    }
    EXPECT_EQ(pairing.gone(), std::vector<std::string>{"2"});
    pairing.add(frame("1", 100), now);
    EXPECT_TRUE(pairing.take(now)) << "at once";
    pairing.add(frame("2", 101), now);
    EXPECT_TRUE(pairing.gone().empty());
    EXPECT_FALSE(pairing.take(now)) << "both are waited for again";
    pairing.add(frame("1", 101), now);
    EXPECT_EQ(pairing.take(now)->frames.size(), 2U);
}

TEST(Pairing, SecondFrameOfAnInstantReplacesTheFirst) {
    Pairing pairing({"1", "2"});
    pairing.add(frame("1", 10, 1), kStart);
    pairing.add(frame("1", 10, 2), kStart);
    pairing.add(frame("2", 10), kStart);
    const auto instant = pairing.take(kStart);
    ASSERT_EQ(instant->frames.size(), 2U);
    EXPECT_EQ(instant->frames[0].sent_ns, 2U);
}

TEST(Pairing, FloodOfSingleFramesTakesNoMemory) {
    Pairing pairing({"1", "2"});
    for (int i = 0; i < 1000; ++i) pairing.add(frame("1", i), kStart);
    EXPECT_EQ(pairing.dropped(), 1000 - Pairing::kMaxPending);
    pairing.add(frame("nobody", 5), kStart);
    EXPECT_FALSE(pairing.take(kStart));
}

}  // namespace
}  // namespace armsight::vision::service
