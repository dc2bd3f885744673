#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "armsight/vision/camera.hpp"
#include "armsight/vision/description.hpp"
#include "armsight/vision/estimate.hpp"

namespace armsight::vision {

/// Whether the cameras still are where they are said to be. Where one camera's own view puts a sphere's centre is
/// compared with where the views of all cameras together put it, and, of a marker that never moves, with where it is
/// described to be. With right calibrations these are apart by less than a tenth of a pixel in the middle of many. The
/// first alone leaves much open: two cameras agree on any point in the plane of their rays, and so don't notice when
/// one of them turns in it. The second notices that as well, and which camera it was.
class CameraCheck {
  public:
    /// Takes the answers to one instant; `markers` in their order. Observations that are half hidden don't count.
    void add(std::span<const MarkerEstimate> estimates, std::span<const MarkerModel> markers,
             std::span<const Camera> cameras);

    /// Pixels by camera's name, the median of lately, the greater of the two; only of cameras that saw enough.
    [[nodiscard]] std::map<std::string, double> residuals_px() const;

    /// What is wrong, and what to do; empty where nothing is, or too little was seen to say.
    [[nodiscard]] std::string trouble() const;

    /// Forgets what was seen: cameras or markers are others.
    void reset() { *this = {}; }

  private:
    /// The newest residuals, pixels.
    class Ring {
      public:
        void add(double px);
        [[nodiscard]] std::optional<double> median() const;  ///< nothing where there are too few

      private:
        std::vector<double> px_;
        std::size_t next_ = 0;
    };
    struct Seen {
        Ring together;          ///< against all cameras
        Ring fixed;             ///< against the description
        std::size_t total = 0;  ///< markers that this camera measured, alone or with others, lately
    };
    std::map<std::string, Seen, std::less<>> by_camera_;
    std::size_t together_ = 0;  ///< markers measured by two cameras or more
    std::size_t alone_ = 0;     ///< by one, while others had frames of the instant as well
};

}  // namespace armsight::vision
