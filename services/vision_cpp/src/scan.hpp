#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "armsight/vision/classify.hpp"

namespace armsight::vision {

/// Appends the runs of every cone's pixels, in one pass, with the widest vectors that this processor has.
/// A pixel belongs to the first cone that contains it: the same as asking ColorCone::contains() for each.
void scan(const ImageView& image, std::span<const ColorCone> cones, std::vector<MarkerMask>& masks);

/// Instruction sets that scan() can run on here, best first.
[[nodiscard]] std::vector<std::string> scan_targets();

/// For tests and benchmarks: scan() uses the one of this name, or again the best one for an empty name.
/// Throws std::invalid_argument for one that is not among scan_targets().
void force_scan_target(const std::string& name);

/// Adds pixels to the end of a mask; joins them with the last run where they touch it.
inline void append_run(std::vector<Run>& runs, int y, int x0, int x1) {
    if (!runs.empty() && runs.back().y == y && runs.back().x1 == x0) {
        runs.back().x1 = x1;
    } else if (runs.size() < kMaxRuns) {
        runs.push_back({.y = y, .x0 = x0, .x1 = x1, .component = -1});
    }
}

}  // namespace armsight::vision
