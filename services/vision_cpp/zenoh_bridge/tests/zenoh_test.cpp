#include "armsight/zenoh.hpp"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <initializer_list>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace armsight::zenoh {
namespace {

constexpr Milliseconds kLong{5000};

std::string text(Bytes bytes) { return {bytes.begin(), bytes.end()}; }

int free_port() {
    const int probe = socket(AF_INET, SOCK_STREAM, 0);
    if (probe < 0) throw std::runtime_error("no socket");
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof(address);
    EXPECT_EQ(bind(probe, reinterpret_cast<const sockaddr*>(&address), size), 0);
    EXPECT_EQ(getsockname(probe, reinterpret_cast<sockaddr*>(&address), &size), 0);
    close(probe);
    return ntohs(address.sin_port);
}

Config config(const std::string& mode, const std::string& endpoint) {
    Config result;
    result.insert_json5("mode", '"' + mode + '"');
    result.insert_json5("scouting/multicast/enabled", "false");
    result.insert_json5("scouting/gossip/enabled", "false");
    result.insert_json5(mode == "router" ? "listen/endpoints" : "connect/endpoints", "[\"" + endpoint + "\"]");
    return result;
}

class Zenoh : public ::testing::Test {
  protected:
    std::string endpoint = "tcp/127.0.0.1:" + std::to_string(free_port());
    Session router = Session::open(config("router", endpoint));
    Session client = Session::open(config("client", endpoint));

    void TearDown() override {
        client.close();
        router.close();
    }

    static Publisher publisher(const Session& session, std::string_view key, bool latched = false) {
        return session.declare_publisher(key, "application/x",
                                         {.block = true, .priority = 5, .express = false, .latched = latched});
    }
    // The client learns of a new queryable a moment later; until then nobody answers.
    [[nodiscard]] std::string ask_until_known(std::string_view key, Bytes payload) const {
        const auto deadline = std::chrono::steady_clock::now() + kLong;
        while (true) {
            try {
                return client.get(key, payload, kLong);
            } catch (const ZException&) {
                if (std::chrono::steady_clock::now() > deadline) throw;
                std::this_thread::sleep_for(Milliseconds{5});
            }
        }
    }
    static void wait_for_subscriber(const Publisher& publisher) {
        for (int i = 0; i < 1000 && !publisher.has_subscribers(); ++i) std::this_thread::sleep_for(Milliseconds{5});
        ASSERT_TRUE(publisher.has_subscribers());
    }
};

TEST_F(Zenoh, SampleArrivesWithAllThatWasPut) {
    const Subscriber subscriber = client.declare_subscriber("camera/*/image", {.capacity = 2});
    const Publisher images = publisher(router, "camera/1/image");
    wait_for_subscriber(images);
    const std::string pixels(2'000'000, 'p');
    images.put(as_bytes(pixels), as_bytes("stamp"));
    const auto sample = subscriber.recv(kLong);
    ASSERT_TRUE(sample);
    EXPECT_TRUE(sample->is_put());
    EXPECT_EQ(sample->get_keyexpr(), "camera/1/image");
    EXPECT_EQ(sample->get_encoding(), "application/x");
    EXPECT_EQ(std::string(sample->get_payload().begin(), sample->get_payload().end()), pixels);
    EXPECT_EQ(text(sample->get_attachment()), "stamp");
    EXPECT_FALSE(subscriber.recv(Milliseconds{20}));
}

TEST_F(Zenoh, SampleOutlivesItsSubscriber) {
    std::optional<Sample> kept;
    {
        const Subscriber subscriber = client.declare_subscriber("k", {});
        const Publisher values = publisher(router, "k");
        wait_for_subscriber(values);
        values.put(as_bytes("value"));
        kept = subscriber.recv(kLong);
    }
    ASSERT_TRUE(kept);
    EXPECT_EQ(std::string(kept->get_payload().begin(), kept->get_payload().end()), "value");
}

TEST_F(Zenoh, LatchedValueReachesWhoComesLate) {
    const Publisher state = publisher(router, "state", true);
    state.put(as_bytes("old"));
    state.put(as_bytes("new"));
    const Subscriber late = client.declare_subscriber("state", {.capacity = 1, .latched = true});
    const auto sample = late.recv(kLong);
    ASSERT_TRUE(sample);
    EXPECT_EQ(sample->get_payload().size(), 3U);
    EXPECT_EQ(sample->get_payload()[0], 'n');
}

TEST_F(Zenoh, QueriesAreAnsweredOrRefusedWithAText) {
    const Queryable queryable = router.declare_queryable("ask");
    std::thread server([&] {
        queryable.recv(kLong)->reply(as_bytes("yes"), "text/plain");
        queryable.recv(kLong)->reply_err("because");
    });
    EXPECT_EQ(ask_until_known("ask", as_bytes("?")), "yes");
    try {
        (void)client.get("ask", {}, kLong);
        FAIL() << "not refused";
    } catch (const ZException& refusal) {
        EXPECT_STREQ(refusal.what(), "because");
    }
    server.join();
    EXPECT_THROW((void)client.get("nobody", {}, Milliseconds{200}), ZException);
}

TEST_F(Zenoh, ReceivingOnAClosedSessionThrowsAndDoesNotHang) {
    const Subscriber subscriber = client.declare_subscriber("k", {});
    std::thread closer([&] {
        std::this_thread::sleep_for(Milliseconds{100});
        client.close();
    });
    EXPECT_THROW(
        {
            for (int i = 0; i < 100; ++i) (void)subscriber.recv(Milliseconds{100});
        },
        ZException);
    closer.join();
}

TEST(ZenohConfig, MistakesAreTold) {
    Config config;
    EXPECT_THROW(config.insert_json5("no/such/path", "1"), ZException);
    EXPECT_THROW((void)Config::from_file("/nowhere.json5"), ZException);
    config.insert_json5("namespace", "\"robots/left\"");
    EXPECT_EQ(config.get_json("namespace"), "\"robots/left\"");
}

TEST(ZenohConfig, NobodyListeningIsAnErrorNotAWait) {
    Config client = config("client", "tcp/127.0.0.1:" + std::to_string(free_port()));
    client.insert_json5("connect/timeout_ms", "300");
    client.insert_json5("connect/exit_on_failure", "true");
    EXPECT_THROW((void)Session::open(client), ZException);
}

TEST_F(Zenoh, LossOfTheRouterIsCounted) {
    EXPECT_EQ(client.routers_lost(), 0U);
    router.close();
    const auto deadline = std::chrono::steady_clock::now() + kLong;
    while (client.routers_lost() == 0 && std::chrono::steady_clock::now() < deadline) {
        std::this_thread::sleep_for(Milliseconds{5});
    }
    EXPECT_EQ(client.routers_lost(), 1U);
    EXPECT_EQ(router.routers_lost(), 0U);
}

TEST_F(Zenoh, RingKeepsTheNewestInTheOrderTheyCame) {
    const Subscriber ring = client.declare_subscriber("k", {.capacity = 2});
    const Subscriber all = client.declare_subscriber("k", {.capacity = 16});
    const Publisher values = publisher(router, "k");
    wait_for_subscriber(values);
    for (const char* value : {"1", "2", "3", "4", "5", "6", "last"}) values.put(as_bytes(value));
    // both are filled by one delivery a value: once the wide one has them all, the ring was pushed seven times or is
    // about to be
    for (const char* value : {"1", "2", "3", "4", "5", "6", "last"}) {
        const auto sample = all.recv(kLong);
        ASSERT_TRUE(sample);
        EXPECT_EQ(text(sample->get_payload()), value);
    }
    std::vector<std::string> kept;
    while (kept.empty() || kept.back() != "last") {
        const auto sample = ring.recv(kLong);
        ASSERT_TRUE(sample);
        kept.push_back(text(sample->get_payload()));
    }
    EXPECT_LE(kept.size(), 3U) << "two kept, and at most one that was overtaken by the reader";
    EXPECT_EQ(kept[kept.size() - 2], "6");
    EXPECT_FALSE(ring.recv(Milliseconds{50}));
}

TEST_F(Zenoh, LatchedSubscriberFindsAPublisherThatComesLate) {
    const Subscriber early = client.declare_subscriber("state", {.capacity = 1, .latched = true});
    EXPECT_FALSE(early.recv(Milliseconds{50}));
    const Publisher state = publisher(router, "state", true);
    state.put(as_bytes("first"));
    const auto sample = early.recv(kLong);
    ASSERT_TRUE(sample);
    EXPECT_EQ(text(sample->get_payload()), "first");
}

TEST_F(Zenoh, EmptyPayloadAndNoAttachmentArriveAsSuch) {
    const Subscriber subscriber = client.declare_subscriber("k", {});
    const Publisher values = publisher(router, "k");
    wait_for_subscriber(values);
    values.put({});
    const auto sample = subscriber.recv(kLong);
    ASSERT_TRUE(sample);
    EXPECT_TRUE(sample->is_put());
    EXPECT_TRUE(sample->get_payload().empty());
    EXPECT_TRUE(sample->get_attachment().empty());
    EXPECT_FALSE(sample->is_shared_memory()) << "over TCP";
}

TEST_F(Zenoh, QueryCarriesItsPayloadAndEveryByteOfTheAnswer) {
    const Queryable queryable = router.declare_queryable("echo");
    std::thread server([&] {
        const auto query = queryable.recv(kLong);
        if (query) query->reply(query->get_payload(), "application/x");
    });
    std::string every(256, '\0');
    for (std::size_t i = 0; i < every.size(); ++i) every[i] = static_cast<char>(i);
    EXPECT_EQ(ask_until_known("echo", as_bytes(every)), every);
    server.join();
}

TEST_F(Zenoh, NobodyAsksAndTheQueryableSaysSo) {
    const Queryable queryable = router.declare_queryable("ask");
    EXPECT_FALSE(queryable.recv(Milliseconds{20}));
}

TEST_F(Zenoh, EverythingOnAClosedSessionThrows) {
    const Publisher values = publisher(client, "k");
    const Queryable queryable = client.declare_queryable("ask");
    client.close();
    EXPECT_THROW(values.put(as_bytes("late")), ZException);
    EXPECT_THROW((void)queryable.recv(kLong), ZException);
    EXPECT_THROW((void)client.declare_subscriber("k", {}), ZException);
    EXPECT_THROW((void)client.get("ask", {}, Milliseconds{100}), ZException);
    EXPECT_NO_THROW(client.close()) << "closing twice is harmless";
}

TEST_F(Zenoh, KeysAndPrioritiesThatCannotBeAreRefused) {
    EXPECT_THROW((void)client.declare_subscriber("/starts/with/slash", {}), ZException);
    EXPECT_THROW((void)client.declare_queryable(""), ZException);
    for (const std::uint8_t priority : std::initializer_list<std::uint8_t>{0, 8, 255}) {
        EXPECT_THROW((void)client.declare_publisher(
                         "k", "", {.block = false, .priority = priority, .express = false, .latched = false}),
                     ZException)
            << int{priority};
    }
}

TEST(ZenohConfig, FileIsReadWithItsComments) {
    const std::string path = ::testing::TempDir() + "armsight_zenoh_test_" + std::to_string(getpid()) + ".json5";
    std::ofstream(path) << "{ /* the robot */ mode: 'client', connect: { endpoints: ['tcp/127.0.0.1:1'] } }";
    const Config config = Config::from_file(path);
    EXPECT_EQ(config.get_json("mode"), "\"client\"");
    EXPECT_EQ(config.get_json("connect/endpoints"), "[\"tcp/127.0.0.1:1\"]");
    std::ofstream(path) << "{ mode: ";
    EXPECT_THROW((void)Config::from_file(path), ZException);
    std::remove(path.c_str());
}

TEST(ZenohConfig, ValueOfTheWrongKindIsRefusedAndChangesNothing) {
    Config config;
    config.insert_json5("namespace", "\"robots/left\"");
    EXPECT_THROW(config.insert_json5("namespace", "17"), ZException);
    EXPECT_THROW(config.insert_json5("namespace", "\"unfinished"), ZException);
    EXPECT_THROW((void)config.get_json("no/such/path"), ZException);
    EXPECT_EQ(config.get_json("namespace"), "\"robots/left\"");
}

}  // namespace
}  // namespace armsight::zenoh
