#pragma once

#include <functional>
#include <mutex>
#include <stdexcept>
#include <string>
#include <vector>

#include "armsight/v1/parameters.pb.h"
#include "armsight/vision/classify.hpp"

namespace armsight::vision::service {

/// A value that cannot be set; the text says what may be.
struct ParameterError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// What may be changed while the service runs.
struct Tunables {
    std::string backend;
    ColorThresholds colors;

    friend bool operator==(const Tunables&, const Tunables&) = default;
};

/// The settings with their bounds and the values in force. Any thread may use it.
class Parameters {
  public:
    explicit Parameters(Tunables start) : in_force_(std::move(start)) {}

    [[nodiscard]] Tunables in_force() const;
    /// As they go over the bus.
    [[nodiscard]] std::vector<v1::Parameter> messages() const;
    /// Takes all values or, where one is refused, none; says whether anything changed. Throws ParameterError.
    bool set(const v1::SetParametersRequest& request);

  private:
    mutable std::mutex mutex_;
    Tunables in_force_;
};

}  // namespace armsight::vision::service
