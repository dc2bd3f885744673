#include "service/parameters.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <string>

#include "armsight/vision/classify.hpp"
#include "service/codec.hpp"

namespace armsight::vision::service {
namespace {

Parameters at_start() { return Parameters({.backend = "simd", .colors = {}}); }

v1::SetParametersRequest number(const std::string& name, double value) {
    v1::SetParametersRequest request;
    (*request.mutable_values())[name].set_number(value);
    return request;
}

v1::SetParametersRequest text(const std::string& name, const std::string& value) {
    v1::SetParametersRequest request;
    (*request.mutable_values())[name].set_text(value);
    return request;
}

std::string refusal(const v1::SetParametersRequest& request) {
    auto parameters = at_start();
    try {
        parameters.set(request);
    } catch (const ParameterError& error) {
        EXPECT_EQ(parameters.in_force(), at_start().in_force()) << "what is refused changes nothing";
        return error.what();
    }
    return "";
}

TEST(Parameters, AreTakenAllTogetherAndTold) {
    auto parameters = at_start();
    auto request = number("chroma_floor", 20.5);
    (*request.mutable_values())["backend"].set_text("opencv");
    (*request.mutable_values())["hue_half_width"].set_whole(15);
    EXPECT_TRUE(parameters.set(request));
    EXPECT_FALSE(parameters.set(request)) << "the same again changes nothing";
    const Tunables now = parameters.in_force();
    EXPECT_EQ(now.backend, "opencv");
    EXPECT_EQ(now.colors.chroma_floor, 20.5);
    EXPECT_EQ(now.colors.hue_half_width_deg, 15.0);
    EXPECT_EQ(now.colors.saturation_share, ColorThresholds{}.saturation_share);
    const auto told = encode_parameters(1'500'000'000, parameters.messages());
    EXPECT_EQ(told.time().seconds(), 1);
    EXPECT_EQ(told.time().nanos(), 500'000'000);
    std::map<std::string, v1::ParameterValue> values;
    for (const auto& parameter : told.parameters()) values[parameter.name()] = parameter.value();
    EXPECT_EQ(values.at("backend").text(), "opencv");
    EXPECT_EQ(values.at("chroma_floor").number(), 20.5);
    EXPECT_EQ(values.at("saturation_share").number(), ColorThresholds{}.saturation_share);
    EXPECT_EQ(values.size(), 4U);
}

TEST(Parameters, OneThatIsRefusedLeavesAllAsTheyWere) {
    auto request = number("chroma_floor", 20.0);
    (*request.mutable_values())["saturation_share"].set_number(0.9);
    EXPECT_EQ(refusal(request), "saturation_share is a number within 0.1 to 0.8, not 0.9");
}

TEST(Parameters, ARefusalSaysWhatMayBe) {
    EXPECT_EQ(refusal(number("chroma_floor", 61.0)), "chroma_floor is a number within 4 to 60 grey levels, not 61");
    EXPECT_EQ(refusal(number("chroma_floor", std::nan(""))),
              "chroma_floor is a number within 4 to 60 grey levels, not nan");
    EXPECT_EQ(refusal(number("hue_half_width", -std::numeric_limits<double>::infinity())),
              "hue_half_width is a number within 5 to 40 deg, not -inf");
    EXPECT_EQ(refusal(text("chroma_floor", "high")), "chroma_floor is a number within 4 to 60 grey levels");
    EXPECT_EQ(refusal(text("backend", "gpu")), "backend is one of simd, opencv");
    EXPECT_EQ(refusal(number("backend", 1.0)), "backend is one of simd, opencv");
    EXPECT_EQ(
        refusal(text("colour", "red")),
        "there is no parameter 'colour' here: backend, chroma_floor, saturation_share, hue_half_width may be set");
    v1::SetParametersRequest nothing;
    (*nothing.mutable_values())["backend"] = {};
    EXPECT_EQ(refusal(nothing), "backend is one of simd, opencv");
}

TEST(Parameters, BytesThatAreNoRequestAreRefused) {
    const std::array<std::uint8_t, 3> bytes{0xff, 0xff, 0xff};
    EXPECT_THROW((void)decode_set_parameters(bytes), MalformedMessage);
}

}  // namespace
}  // namespace armsight::vision::service
