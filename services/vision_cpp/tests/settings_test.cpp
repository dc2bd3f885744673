#include "service/settings.hpp"

#include <gtest/gtest.h>

#include <cstdlib>

#include "service/session_config.hpp"

namespace armsight::vision::service {
namespace {

std::optional<Settings> parsed(std::vector<const char*> flags) {
    flags.insert(flags.begin(), "armsight-vision");
    return parse_settings(static_cast<int>(flags.size()), flags.data());
}

class Environment : public ::testing::Test {
  protected:
    void SetUp() override { clear(); }
    void TearDown() override { clear(); }
    static void clear() {
        for (const char* name :
             {"ARMSIGHT_CONNECT", "ARMSIGHT_NAMESPACE", "ARMSIGHT_ZENOH_CONFIG", "ARMSIGHT_SHARED_MEMORY"}) {
            unsetenv(name);
        }
    }
};

TEST_F(Environment, FlagsWinOverTheEnvironment) {
    setenv("ARMSIGHT_CONNECT", "tcp/a:1,tcp/b:2", 1);
    setenv("ARMSIGHT_NAMESPACE", "robots/left", 1);
    EXPECT_EQ(parsed({})->connect, (std::vector<std::string>{"tcp/a:1", "tcp/b:2"}));
    EXPECT_EQ(parsed({})->name_space, "robots/left");
    const auto settings = parsed({"--connect", "tcp/c:3", "--namespace", "robots/right"});
    EXPECT_EQ(settings->connect, std::vector<std::string>{"tcp/c:3"});
    EXPECT_EQ(settings->name_space, "robots/right");
}

TEST_F(Environment, ValuesThatCannotWorkAreRefusedWithAReason) {
    EXPECT_THROW((void)parsed({"--connect", "localhost"}), ConfigError);
    EXPECT_THROW((void)parsed({"--namespace", "robots/*"}), ConfigError);
    EXPECT_THROW((void)parsed({"--namespace", "/arm"}), ConfigError);
    EXPECT_THROW((void)parsed({"--log-level", "loud"}), ConfigError);
    EXPECT_THROW((void)parsed({"--no-such-flag"}), ConfigError);
}

TEST_F(Environment, SessionIsAClientWithTheDefaultsOfAllServices) {
    const zenoh::Config config = session_config(*parsed({}), true);
    EXPECT_EQ(config.get_json("mode"), "\"client\"");
    EXPECT_EQ(config.get_json("connect/endpoints"), "[\"tcp/127.0.0.1:7447\"]");
    EXPECT_EQ(config.get_json("namespace"), "\"robots/arm\"");
    EXPECT_EQ(config.get_json("scouting/multicast/enabled"), "false");
    EXPECT_EQ(config.get_json("transport/shared_memory/enabled"), "true");
    EXPECT_EQ(config.get_json("transport/link/tx/queue/size/data_low"), "16");
}

TEST_F(Environment, MissingConfigurationFileIsAnErrorOfOurs) {
    EXPECT_THROW((void)session_config(*parsed({"--zenoh-config", "/nowhere.json5"}), false), ConfigError);
}

}  // namespace
}  // namespace armsight::vision::service
