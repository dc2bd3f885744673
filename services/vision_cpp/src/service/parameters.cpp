#include "service/parameters.hpp"

#include <algorithm>
#include <array>
#include <sstream>
#include <string_view>
#include <utility>

#include "armsight/vision/backend.hpp"

namespace armsight::vision::service {
namespace {

constexpr const char* kBackend = "backend";

// A number of the colour thresholds.
struct Number {
    const char* name;
    const char* description;
    const char* unit;
    double least;
    double most;
    double ColorThresholds::* field;
};

constexpr std::array kNumbers{
    Number{.name = "chroma_floor",
           .description = "distance from grey below which a pixel has no colour",
           .unit = "grey levels",
           .least = 4.0,
           .most = 60.0,
           .field = &ColorThresholds::chroma_floor},
    Number{.name = "saturation_share",
           .description = "of a marker's own saturation that its pixels must have",
           .unit = "",
           .least = 0.1,
           .most = 0.8,
           .field = &ColorThresholds::saturation_share},
    Number{.name = "hue_half_width",
           .description = "of a marker's colour, less where another marker's is near",
           .unit = "deg",
           .least = 5.0,
           .most = 40.0,
           .field = &ColorThresholds::hue_half_width_deg},
};

double checked(const Number& number, const v1::ParameterValue& value) {
    std::ostringstream text;
    text << number.name << " is a number within " << number.least << " to " << number.most;
    if (!std::string_view(number.unit).empty()) text << ' ' << number.unit;
    const bool is_whole = value.kind_case() == v1::ParameterValue::kWhole;
    if (!is_whole && value.kind_case() != v1::ParameterValue::kNumber) throw ParameterError(text.str());
    const double given = is_whole ? static_cast<double>(value.whole()) : value.number();
    if (!(given >= number.least && given <= number.most)) {
        text << ", not " << given;
        throw ParameterError(text.str());
    }
    return given;
}

void take(Tunables& tunables, const std::string& name, const v1::ParameterValue& value) {
    if (name == kBackend) {
        const bool is_one = value.kind_case() == v1::ParameterValue::kText &&
                            std::ranges::find(kBackends, value.text()) != kBackends.end();
        if (!is_one) throw ParameterError("backend is one of simd, opencv");
        tunables.backend = value.text();
        return;
    }
    const auto number = std::ranges::find(kNumbers, std::string_view(name), &Number::name);
    if (number == kNumbers.end()) {
        throw ParameterError("there is no parameter '" + name +
                             "' here: backend, chroma_floor, saturation_share, hue_half_width may be set");
    }
    tunables.colors.*number->field = checked(*number, value);
}

}  // namespace

Tunables Parameters::in_force() const {
    const std::scoped_lock lock(mutex_);
    return in_force_;
}

std::vector<v1::Parameter> Parameters::messages() const {
    const Tunables tunables = in_force();
    std::vector<v1::Parameter> result;
    v1::Parameter backend;
    backend.set_name(kBackend);
    backend.set_description("what finds the markers' pixels; the past of the markers is forgotten");
    backend.mutable_value()->set_text(tunables.backend);
    for (const std::string_view choice : kBackends) backend.add_choices(std::string(choice));
    result.push_back(std::move(backend));
    for (const Number& number : kNumbers) {
        v1::Parameter parameter;
        parameter.set_name(number.name);
        parameter.set_description(number.description);
        parameter.set_unit(number.unit);
        parameter.set_least(number.least);
        parameter.set_most(number.most);
        parameter.mutable_value()->set_number(tunables.colors.*number.field);
        result.push_back(std::move(parameter));
    }
    return result;
}

bool Parameters::set(const v1::SetParametersRequest& request) {
    const std::scoped_lock lock(mutex_);
    Tunables wanted = in_force_;
    for (const auto& [name, value] : request.values()) take(wanted, name, value);
    if (wanted == in_force_) return false;
    in_force_ = std::move(wanted);
    return true;
}

}  // namespace armsight::vision::service
