#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "armsight/vision/box.hpp"
#include "armsight/vision/classify.hpp"
#include "armsight/vision/edges.hpp"
#include "armsight/vision/estimate.hpp"
#include "armsight/vision/pipeline.hpp"
#include "armsight/vision/track.hpp"

namespace armsight::vision {

/// A sphere of the box's colour, where it was just found: what is its own is not the box's.
struct SameColoredSphere {
    Eigen::Vector3d position;  ///< world frame, metres
    double radius;
};

/// From the patches of its colour to one box, and what is remembered of it.
class BoxFinder {
  public:
    /// `cone` is the index of the box's colour among the masks of a frame.
    explicit BoxFinder(std::size_t cone) : cone_index_(cone) {}

    /// Where the box is at an instant; the name in `result` stays. `masks` are by frame, then colour.
    void find(std::int64_t capture_ns, std::span<const CameraFrame> frames,
              std::span<const std::vector<MarkerMask>> masks, const ColorCone& cone,
              std::span<const SameColoredSphere> spheres, MarkerEstimate& result);

    /// Adds the corners and the inliers of the box that was found last.
    void show_outline(Observation& observation) const;

    void reset();

  private:
    struct Sighting {
        const CameraFrame* frame = nullptr;
        Outline outline;
        Disc around;             ///< where the box is as far as known
        bool is_merged = false;  ///< one patch with a sphere
    };
    struct Finding {
        BoxFix fix;
        bool whole = false;  ///< all of its outline seen in two views
    };
    // A body keeps its extent: what was seen of it from all sides holds where one is hidden.
    struct Extent {
        Eigen::Vector3d half;
        Eigen::Matrix3d covariance;
    };

    // What all steps of one instant look at.
    struct Scene {
        std::int64_t capture_ns;
        std::span<const CameraFrame> frames;
        std::span<const std::vector<MarkerMask>> masks;
        const ColorCone& cone;
        std::span<const SameColoredSphere> spheres;
    };

    void look(const Scene& scene);
    void find_own_edges(const Scene& scene, Sighting& sighting);
    [[nodiscard]] std::optional<Finding> locate(const Scene& scene);
    [[nodiscard]] std::optional<Finding> settle(const Box& from, std::int64_t capture_ns) const;
    void remember(const Box& box, const Eigen::Matrix3d& covariance);
    [[nodiscard]] bool is_one_sided() const;
    [[nodiscard]] bool is_outlined(const Box& box) const;
    [[nodiscard]] bool is_agreed(const Box& box) const;
    [[nodiscard]] std::optional<Box> start(std::int64_t capture_ns) const;
    [[nodiscard]] std::optional<BoxPrior> prior(std::int64_t capture_ns) const;
    [[nodiscard]] PoolVector<BoxView> views() const;

    std::size_t cone_index_;
    Track track_;
    std::optional<Extent> extent_;
    EdgeScratch scratch_;
    PoolVector<Sighting> sightings_;
    Box found_{.centre = Eigen::Vector3d::Zero(), .half = Eigen::Vector3d::Zero()};
};

}  // namespace armsight::vision
