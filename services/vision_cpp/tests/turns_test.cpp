#include "service/turns.hpp"

#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <thread>
#include <vector>

namespace armsight::vision::service {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

const SteadyTime kStart{};

std::vector<std::size_t> taken(Rota& rota, int turns, SteadyTime again) {
    std::vector<std::size_t> result;
    for (int i = 0; i < turns; ++i) {
        const auto robot = rota.take(kStart);
        if (!robot) break;
        result.push_back(*robot);
        rota.give_back(*robot, again);
    }
    return result;
}

TEST(Rota, RobotsThatAlwaysHaveSomethingTakeTurns) {
    Rota rota(3);
    EXPECT_EQ(taken(rota, 7, kStart), (std::vector<std::size_t>{0, 1, 2, 0, 1, 2, 0}));
}

TEST(Rota, OneThatFloodsWaitsForEveryOtherThatIsDue) {
    Rota rota(4);
    (void)taken(rota, 4, SteadyTime::max());
    rota.due(2, kStart);
    EXPECT_EQ(rota.take(kStart), 2U);
    for (int more = 0; more < 100; ++more) rota.due(2, kStart);  // while it is measured
    rota.due(0, kStart);
    rota.due(1, kStart);
    rota.give_back(2, SteadyTime::max());
    EXPECT_EQ(taken(rota, 4, SteadyTime::max()), (std::vector<std::size_t>{0, 1, 2}));
}

TEST(Rota, RobotInSomebodysHandsIsHandedToNobodyElse) {
    Rota rota(2);
    EXPECT_EQ(rota.take(kStart), 0U);
    EXPECT_EQ(rota.take(kStart), 1U);
    rota.due(0, kStart);
    EXPECT_FALSE(rota.take(kStart));
    EXPECT_FALSE(rota.next_due());
    rota.give_back(0, SteadyTime::max());
    EXPECT_EQ(rota.take(kStart), 0U) << "what came meanwhile is not forgotten";
}

TEST(Rota, RobotIsDueWhenItSaidAndNotBefore) {
    Rota rota(2);
    (void)taken(rota, 2, kStart + milliseconds{20});
    rota.due(1, kStart + milliseconds{10});
    EXPECT_EQ(rota.next_due(), kStart + milliseconds{10});
    EXPECT_FALSE(rota.take(kStart + milliseconds{9}));
    EXPECT_EQ(rota.take(kStart + milliseconds{10}), 1U);
    EXPECT_FALSE(rota.take(kStart + milliseconds{19}));
    EXPECT_EQ(rota.take(kStart + milliseconds{20}), 0U);
}

TEST(Rota, SharesAreEqualWhateverEachOneHas) {
    // setup: robot 0 always has something, the others now and then, and less than their share
    Rota rota(4);
    std::array<int, 4> had{};
    std::array<int, 4> asked{};
    for (int step = 0; step < 4000; ++step) {
        rota.due(0, kStart);
        for (std::size_t robot = 1; robot < 4; ++robot) {
            if (step % (4 + static_cast<int>(robot)) != 0) continue;
            rota.due(robot, kStart);
            ++asked.at(robot);
        }
        if (const auto robot = rota.take(kStart)) {
            ++had.at(*robot);
            rota.give_back(*robot, SteadyTime::max());
        }
    }
    // all that was asked was had: at most the last is still open
    for (std::size_t robot = 1; robot < 4; ++robot) EXPECT_GE(had.at(robot), asked.at(robot) - 4);
    EXPECT_GT(had.at(0), 1000) << "and what is left goes to the one that wants more";
}

TEST(Turns, NobodyIsHandedOutUntilSomebodyIsDue) {
    Turns turns(1);
    EXPECT_EQ(turns.take(steady_clock::now()), 0U);
    turns.give_back(0, SteadyTime::max());
    EXPECT_FALSE(turns.take(steady_clock::now() + milliseconds{5}));
    turns.wake(0);
    EXPECT_EQ(turns.take(steady_clock::now()), 0U);
}

TEST(Turns, OneThatIsDueLaterIsWaitedFor) {
    Turns turns(1);
    (void)turns.take(steady_clock::now());
    const auto again = steady_clock::now() + milliseconds{30};
    turns.give_back(0, again);
    EXPECT_EQ(turns.take(steady_clock::now() + std::chrono::seconds{20}), 0U);
    EXPECT_GE(steady_clock::now(), again);
}

TEST(Turns, ThreadsShareRobotsAndNoneIsInTwoHands) {
    constexpr std::size_t kRobots = 5;
    constexpr int kEach = 300;
    Turns turns(kRobots);
    std::array<int, kRobots> done{};                  // without a lock: that is the point
    std::array<std::atomic<int>, kRobots> waiting{};  // what each has to do
    std::atomic<int> left{kRobots * kEach};
    std::vector<std::jthread> threads;
    for (int worker = 0; worker < 3; ++worker) {
        threads.emplace_back([&] {
            while (left > 0) {
                const auto robot = turns.take(steady_clock::now() + milliseconds{100});
                if (!robot) continue;
                if (waiting.at(*robot) > 0) {
                    --waiting.at(*robot);
                    ++done.at(*robot);
                    --left;
                }
                turns.give_back(*robot, waiting.at(*robot) > 0 ? steady_clock::now() : SteadyTime::max());
            }
        });
    }
    threads.emplace_back([&] {
        for (int i = 0; i < kEach; ++i) {
            for (std::size_t robot = 0; robot < kRobots; ++robot) {
                ++waiting.at(robot);
                turns.wake(robot);
            }
        }
    });
    threads.clear();
    for (const int each : done) EXPECT_EQ(each, kEach);
}

TEST(Turns, ClosingEndsTheWait) {
    Turns turns(1);
    (void)turns.take(steady_clock::now());
    std::jthread closer([&] { turns.close(); });
    EXPECT_FALSE(turns.take(steady_clock::now() + std::chrono::seconds{20}));
}

}  // namespace
}  // namespace armsight::vision::service
