#include "armsight/zenoh.hpp"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

#include <stdexcept>
#include <thread>
#include <vector>

namespace armsight::zenoh {
namespace {

constexpr Milliseconds kLong{5000};

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
    EXPECT_EQ(sample->get_attachment().size(), 5U);
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
    std::this_thread::sleep_for(Milliseconds{200});
    EXPECT_EQ(client.get("ask", as_bytes("?"), kLong), "yes");
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

}  // namespace
}  // namespace armsight::zenoh
