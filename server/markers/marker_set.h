#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "motion/anatomy.h"
#include "motion/markers.h"
#include "motion/suit.h"

/// Which markers sit where on a body: what calibration knows before it has seen the wearer.
/// Kept in marker_sets/*.toml, or made from a photodetector suit. Frame: B the canonical segment.
namespace secondskin::server {

/// A bony place that the hip centres are told from.
enum class Landmark : std::uint8_t {
  kNone,
  kLeftAnteriorIliacSpine,
  kRightAnteriorIliacSpine,
  kLeftPosteriorIliacSpine,
  kRightPosteriorIliacSpine,
  kSacrum,  ///< midway between the posterior iliac spines
};

/// One marker of a set, on the set's nominal body.
struct MarkerPlace {
  std::vector<std::string> names;  ///< the usual one, then others; each unique in the set
  Joint segment{};
  Eigen::Vector3d p_BM = Eigen::Vector3d::Zero();  ///< [m]
  Eigen::Vector3d spread{0.02, 0.02, 0.02};  ///< how far from there it sits on people, 1 sigma [m]
  double sway = 0.008;                       ///< how far skin carries it, 1 sigma [m]
  Landmark landmark = Landmark::kNone;
};

/// An immutable list of places on one nominal body.
class MarkerSet {
 public:
  /// @throws std::invalid_argument unless the skeleton is canonical and the names unique.
  MarkerSet(std::string name, Skeleton nominal, std::vector<MarkerPlace> places);

  /// Reads a set: name, stature, [[marker]] names, segment, at, spread, sway, landmark; `mirror`
  /// names the same marker of the other side. @throws std::runtime_error naming file, line, field
  /// and what was expected.
  static MarkerSet load(const std::filesystem::path& file);

  /// The set in `folder` that knows most of the names, at least kLeastMarkers on three segments.
  /// @throws std::runtime_error listing the names when none does.
  static MarkerSet choose(const std::filesystem::path& folder,
                          const std::vector<std::string>& names);

  /// A suit's detectors on a body of these proportions.
  /// @throws std::invalid_argument unless the skeleton is canonical.
  static MarkerSet from_suit(const Suit& suit, const Skeleton& nominal);

  /// Fewer markers are no body.
  static constexpr std::size_t kLeastMarkers = 6;

  const std::string& name() const noexcept { return name_; }
  const Skeleton& nominal() const noexcept { return nominal_; }
  const std::vector<MarkerPlace>& places() const noexcept { return places_; }

  /// Each place's marker among `names` (a subject's prefix does not matter); empty where the place
  /// has none.
  std::vector<std::optional<std::size_t>> match(const std::vector<std::string>& names) const;

 private:
  std::string name_;
  Skeleton nominal_;
  std::vector<MarkerPlace> places_;
};

}  // namespace secondskin::server
