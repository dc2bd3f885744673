#include "service/settings.hpp"

#include <gtest/gtest.h>

#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "service/session_config.hpp"
#include "service/shared_memory.hpp"

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
    EXPECT_EQ(parsed({})->robots, std::vector<std::string>{"robots/left"});
    const auto settings = parsed({"--connect", "tcp/c:3", "--namespace", "robots/right"});
    EXPECT_EQ(settings->connect, std::vector<std::string>{"tcp/c:3"});
    EXPECT_EQ(settings->robots, std::vector<std::string>{"robots/right"});
}

TEST_F(Environment, ValuesThatCannotWorkAreRefusedWithAReason) {
    EXPECT_THROW((void)parsed({"--connect", "localhost"}), ConfigError);
    EXPECT_THROW((void)parsed({"--namespace", "robots/*"}), ConfigError);
    EXPECT_THROW((void)parsed({"--namespace", "/arm"}), ConfigError);
    EXPECT_THROW((void)parsed({"--log-level", "loud"}), ConfigError);
    EXPECT_THROW((void)parsed({"--no-such-flag"}), ConfigError);
}

TEST_F(Environment, EndpointsOfEveryKindAreTaken) {
    for (const char* endpoint :
         {"tcp/[::1]:7447", "tls/router.local:7447#so_sndbuf=1", "udp/h:1?rel=0", "unixsock-stream//tmp/armsight"}) {
        EXPECT_NO_THROW(check_endpoint(endpoint)) << endpoint;
    }
    for (const char* endpoint : {"", "localhost:7447", "tcp/", "/x", "tcp/h", "tcp/:1", "tcp/h:", "tcp/h:0",
                                 "tcp/h:65536", "tcp/h:99999", "tls/h:x#a=b"}) {
        EXPECT_THROW(check_endpoint(endpoint), ConfigError) << endpoint;
    }
}

TEST_F(Environment, SessionIsAClientWithTheDefaultsOfAllServices) {
    const zenoh::Config config = session_config(*parsed({}), "", true);
    EXPECT_EQ(config.get_json("mode"), "\"client\"");
    EXPECT_EQ(config.get_json("connect/endpoints"), "[\"tcp/127.0.0.1:7447\"]");
    EXPECT_EQ(config.get_json("namespace"), "\"robots/arm\"");
    EXPECT_EQ(config.get_json("scouting/multicast/enabled"), "false");
    EXPECT_EQ(config.get_json("transport/shared_memory/enabled"), "true");
    EXPECT_EQ(config.get_json("transport/link/tx/queue/size/data_low"), "16");
    EXPECT_EQ(config.get_json("transport/link/tx/lease"), "3000");
    EXPECT_EQ(config.get_json("transport/unicast/open_timeout"), "2500");
}

TEST_F(Environment, MissingConfigurationFileIsAnErrorOfOurs) {
    EXPECT_THROW((void)session_config(*parsed({"--zenoh-config", "/nowhere.json5"}), "", false), ConfigError);
}

TEST_F(Environment, NothingGivenLeavesTheDefaults) {
    const auto settings = parsed({});
    EXPECT_TRUE(settings->connect.empty());
    EXPECT_EQ(settings->robots, std::vector<std::string>{""}) << "one robot, by the name in the file or the default";
    EXPECT_EQ(settings->zenoh_config, "");
    EXPECT_EQ(settings->log_level, "warning");
    EXPECT_TRUE(settings->shared_memory);
    EXPECT_FALSE(settings->health);
}

TEST_F(Environment, EveryVariableIsRead) {
    setenv("ARMSIGHT_ZENOH_CONFIG", "/some/file.json5", 1);
    setenv("ARMSIGHT_SHARED_MEMORY", "off", 1);
    EXPECT_EQ(parsed({})->zenoh_config, "/some/file.json5");
    EXPECT_FALSE(parsed({})->shared_memory);
    EXPECT_EQ(parsed({"--zenoh-config", "/other.json5"})->zenoh_config, "/other.json5");
}

TEST_F(Environment, ItsValuesAreCheckedLikeFlags) {
    setenv("ARMSIGHT_CONNECT", "tcp/a:1,localhost", 1);
    EXPECT_THROW((void)parsed({}), ConfigError);
    clear();
    setenv("ARMSIGHT_NAMESPACE", "robots//arm", 1);
    EXPECT_THROW((void)parsed({}), ConfigError);
}

TEST_F(Environment, RefusalsNameWhatIsWrong) {
    const auto text_of = [](const std::vector<const char*>& flags) -> std::string {
        try {
            (void)parsed(flags);
        } catch (const ConfigError& error) {
            return error.what();
        }
        return "accepted";
    };
    EXPECT_NE(text_of({"--connect", "tcp/"}).find("tcp/"), std::string::npos);
    EXPECT_NE(text_of({"--connect", "/host:1"}).find("/host:1"), std::string::npos);
    EXPECT_NE(text_of({"--namespace", "robots/arm/"}).find("robots/arm/"), std::string::npos);
    EXPECT_NE(text_of({"--namespace", "a$b"}).find("a$b"), std::string::npos);
    EXPECT_NE(text_of({"--log-level", "loud"}).find("loud"), std::string::npos);
    EXPECT_NE(text_of({"--connect"}), "accepted");
    EXPECT_NE(text_of({"stray"}), "accepted");
}

TEST_F(Environment, ConnectMayBeGivenAgain) {
    EXPECT_EQ(parsed({"--connect", "tcp/a:1", "--connect", "tcp/b:2"})->connect,
              (std::vector<std::string>{"tcp/a:1", "tcp/b:2"}));
}

TEST_F(Environment, SeveralRobotsAreServedByFlagsOrByAListInTheEnvironment) {
    const std::vector<std::string> both{"robots/a", "robots/b"};
    EXPECT_EQ(parsed({"--namespace", "robots/a", "--namespace", "robots/b"})->robots, both);
    setenv("ARMSIGHT_NAMESPACE", "robots/a,robots/b", 1);
    EXPECT_EQ(parsed({})->robots, both);
    EXPECT_EQ(parsed({"--namespace", "robots/c"})->robots, std::vector<std::string>{"robots/c"}) << "flags win";
    const auto settings = parsed({});
    EXPECT_EQ(session_config(*settings, settings->robots[1], false).get_json("namespace"), "\"robots/b\"");
}

TEST_F(Environment, EveryRobotsNameIsCheckedAndGivenOnce) {
    EXPECT_THROW((void)parsed({"--namespace", "robots/a", "--namespace", "robots/*"}), ConfigError);
    EXPECT_THROW((void)parsed({"--namespace", "robots/a", "--namespace", "robots/a"}), ConfigError);
    setenv("ARMSIGHT_NAMESPACE", "robots/a,robots//b", 1);
    EXPECT_THROW((void)parsed({}), ConfigError);
}

TEST_F(Environment, HelpIsPrintedAndNothingRuns) {
    ::testing::internal::CaptureStdout();
    EXPECT_FALSE(parsed({"--help"}));
    EXPECT_NE(::testing::internal::GetCapturedStdout().find("--namespace"), std::string::npos);
}

TEST(SharedMemory, EveryRobotBringsAPoolThatMustBeLocked) {
    constexpr std::uint64_t kPool = 6U << 20U;  // proto/armsight/shared_memory.py
    EXPECT_EQ(shared_memory_lock_bytes(16) - shared_memory_lock_bytes(1), 15 * kPool);
    EXPECT_GT(shared_memory_lock_bytes(1), kPool);
}

class ConfigurationFile : public Environment {
  protected:
    std::string path = ::testing::TempDir() + "armsight_settings_test_" + std::to_string(getpid()) + ".json5";
    void write(const std::string& text) const { std::ofstream(path) << text; }
    void TearDown() override {
        std::remove(path.c_str());
        Environment::TearDown();
    }
    [[nodiscard]] zenoh::Config config(std::vector<const char*> flags = {}) const {
        flags.insert(flags.end(), {"--zenoh-config", path.c_str()});
        const auto settings = parsed(flags);
        return session_config(*settings, settings->robots.front(), false);
    }
};

TEST(SharedMemory, IsLeftAloneWhereThereIsNoRoomOrNoLeave) {
    EXPECT_TRUE(may_lock(0));
    if (!may_lock(shared_memory_lock_bytes(1))) {
        EXPECT_NE(why_no_shared_memory(1).find("ulimit -l"), std::string::npos);
        return;
    }
    EXPECT_EQ(why_no_shared_memory(1, std::filesystem::temp_directory_path()), "") << "a disk with room";
    EXPECT_NE(why_no_shared_memory(1, "/nowhere").find("can't write there"), std::string::npos);
    EXPECT_NE(why_no_shared_memory(1, "/proc").find("0 bytes free"), std::string::npos)
        << "no room for anybody's files";
}

TEST_F(ConfigurationFile, WinsOverDefaultsAndLosesToFlags) {
    write("{ connect: { endpoints: ['tcp/file:1'] }, namespace: 'robots/file', /* JSON5 */ }");
    EXPECT_EQ(config().get_json("connect/endpoints"), "[\"tcp/file:1\"]");
    EXPECT_EQ(config().get_json("namespace"), "\"robots/file\"");
    const zenoh::Config flagged = config({"--connect", "tcp/flag:2", "--namespace", "robots/flag"});
    EXPECT_EQ(flagged.get_json("connect/endpoints"), "[\"tcp/flag:2\"]");
    EXPECT_EQ(flagged.get_json("namespace"), "\"robots/flag\"");
    EXPECT_EQ(flagged.get_json("transport/shared_memory/enabled"), "false");
}

TEST_F(ConfigurationFile, MayHoldAListOfEndpointsForEachMode) {
    write("{ connect: { endpoints: { router: ['tcp/r:1'], client: ['tcp/c:2'] } } }");
    EXPECT_EQ(config().get_json("connect/endpoints"), "[\"tcp/c:2\"]");
    write("{ connect: { endpoints: ['tcp/c:99999'] } }");
    EXPECT_THROW((void)config(), ConfigError);
}

TEST_F(ConfigurationFile, FilesOfTlsAreNamedRelativeToItAndMustBeThere) {
    const auto ca = std::filesystem::absolute(path).parent_path() / "settings_test_ca.pem";
    write("{ transport: { link: { tls: { root_ca_certificate: 'settings_test_ca.pem' } } } }");
    std::filesystem::remove(ca);
    EXPECT_THROW((void)config(), ConfigError);
    std::ofstream(ca) << "CA";
    EXPECT_EQ(config().get_json("transport/link/tls/root_ca_certificate"), '"' + ca.string() + '"');
    std::filesystem::remove(ca);
}

TEST_F(ConfigurationFile, OfAnotherServiceIsRefused) {
    write("{ metadata: { role: 'vision' } }");
    EXPECT_NO_THROW((void)config());
    write("{ metadata: { name: 'strawberry' } }");
    EXPECT_NO_THROW((void)config());
    write("{ metadata: { role: 'sim' } }");
    EXPECT_THROW((void)config(), ConfigError);
}

TEST_F(ConfigurationFile, WhatIsWrongIsToldWithoutZenohsSources) {
    write("{ mode: ");
    try {
        (void)config();
        FAIL() << "accepted";
    } catch (const ConfigError& error) {
        EXPECT_EQ(std::string(error.what()).find(".rs:"), std::string::npos) << error.what();
    }
}

TEST_F(ConfigurationFile, ThatIsNoneIsAnErrorOfOurs) {
    for (const char* text : {"", "{ mode: ", "not json5 at all", "{ no_such_setting: 1 }"}) {
        write(text);
        EXPECT_THROW((void)config(), ConfigError) << text;
    }
}

}  // namespace
}  // namespace armsight::vision::service
