#include "service/pairing.hpp"

#include <gtest/gtest.h>

#include <memory>
#include <utility>

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
    EXPECT_EQ(pairing.take(kStart)->capture_ns, 1000 - static_cast<std::int64_t>(Pairing::kMaxPending));
    EXPECT_FALSE(pairing.take(kStart));
}

TEST(Pairing, CompleteInstantsAreGivenOutInTheOrderTheyCame) {
    Pairing pairing({"1", "2"});
    for (const std::int64_t capture_ns : {10, 11, 12}) {
        pairing.add(frame("2", capture_ns), kStart);
        pairing.add(frame("1", capture_ns), kStart);
    }
    for (const std::int64_t capture_ns : {10, 11, 12}) EXPECT_EQ(pairing.take(kStart)->capture_ns, capture_ns);
    EXPECT_FALSE(pairing.take(kStart));
    EXPECT_EQ(pairing.dropped(), 0U);
}

TEST(Pairing, TimeThatGoesBackIsAnotherRunAndIsPairedAsWell) {
    Pairing pairing({"1", "2"});
    for (const std::int64_t capture_ns : {1000, 10}) {
        pairing.add(frame("1", capture_ns), kStart);
        pairing.add(frame("2", capture_ns), kStart);
        EXPECT_EQ(pairing.take(kStart)->capture_ns, capture_ns);
    }
}

TEST(Pairing, OneLostFrameNowAndThenDoesNotMakeACameraGone) {
    Pairing pairing({"1", "2"});
    SteadyTime now = kStart;
    for (int i = 0; i < 20; ++i) {
        pairing.add(frame("1", i), now);
        if (i % 2 == 0) pairing.add(frame("2", i), now);
        now += Pairing::kPatience;
        ASSERT_TRUE(pairing.take(now)) << "instant " << i;
        EXPECT_TRUE(pairing.gone().empty()) << "instant " << i;
    }
}

TEST(Pairing, DroppedFramesFreeTheirBytes) {
    Pairing pairing({"1", "2"});
    const auto bytes = std::make_shared<int>(0);
    Frame lost = frame("1", 10);
    lost.owner = bytes;
    pairing.add(std::move(lost), kStart);
    EXPECT_EQ(bytes.use_count(), 2);
    pairing.add(frame("1", 11), kStart);
    pairing.add(frame("2", 11), kStart);
    EXPECT_EQ(pairing.take(kStart)->capture_ns, 11);
    EXPECT_EQ(bytes.use_count(), 1);
}

// Both ends of what cameras do: at high rates more frames wait within kPatience than Pairing keeps.
TEST(Pairing, CameraThatFallsSilentIsGivenUpAtEveryFrameRate) {
    for (const int period_ms : {8, 16, 33, 66, 200}) {
        Pairing pairing({"1", "2"});
        int alone = 0;
        for (int ms = 0; ms < 4000; ++ms) {
            const SteadyTime now = kStart + milliseconds{ms};
            if (ms % period_ms == 0) {
                pairing.add(frame("1", ms), now);
                if (ms < 1000) pairing.add(frame("2", ms), now);
            }
            while (const auto instant = pairing.take(now)) {
                if (instant->frames.size() == 1) ++alone;
            }
        }
        EXPECT_EQ(pairing.gone(), std::vector<std::string>{"2"}) << "a frame each " << period_ms << " ms";
        EXPECT_GT(alone, 1000 / period_ms) << "a frame each " << period_ms << " ms";
    }
}

TEST(Pairing, CompleteInstantsAreGivenOutInOrderWhileTheyAreWorthIt) {
    Pairing pairing({"1", "2"});
    const auto late = kStart + milliseconds{50};
    for (const int ns : {10, 11}) {
        for (const char* camera : {"1", "2"}) pairing.add(frame(camera, ns), ns == 10 ? kStart : late);
    }
    EXPECT_EQ(pairing.take(late)->capture_ns, 10);
    EXPECT_EQ(pairing.take(late)->capture_ns, 11);
    EXPECT_EQ(pairing.dropped(), 0U);
}

TEST(Pairing, TheNewestOfThemWinsWhenTheFirstIsTooLateToMoveAnArm) {
    Pairing pairing({"1", "2"});
    for (const int ns : {10, 11, 12}) {
        for (const char* camera : {"1", "2"}) pairing.add(frame(camera, ns), kStart);
    }
    EXPECT_EQ(pairing.take(kStart + Pairing::kWorth)->capture_ns, 12);
    EXPECT_EQ(pairing.dropped(), 4U);
    EXPECT_FALSE(pairing.take(kStart + Pairing::kWorth));
}

TEST(Pairing, SaysWhenItHasSomethingToGive) {
    Pairing pairing({"1", "2"});
    EXPECT_FALSE(pairing.due());
    pairing.add(frame("1", 10), kStart);
    EXPECT_EQ(pairing.due(), kStart + Pairing::kPatience);
    pairing.add(frame("2", 10), kStart + milliseconds{5});
    EXPECT_LE(*pairing.due(), kStart + milliseconds{5});
    EXPECT_TRUE(pairing.take(*pairing.due()));
    EXPECT_FALSE(pairing.due());
}

TEST(Pairing, IsDueWhenItIsFull) {
    Pairing pairing({"1", "2"});
    for (std::size_t i = 0; i < Pairing::kMaxPending; ++i) {
        pairing.add(frame("1", static_cast<std::int64_t>(i)), kStart);
    }
    EXPECT_EQ(pairing.due(), kStart);
    EXPECT_TRUE(pairing.take(kStart));
}

}  // namespace
}  // namespace armsight::vision::service
