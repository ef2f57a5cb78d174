#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "coach/tactile/body_map.h"

/// What one learner's skin feels, as `secondskin calibrate tactors` measures it, and how it shapes
/// the mapping (Second Skin, 5.1: what is intuitive, and what must be learnt).
namespace secondskin::coach {

/// One site of the learner's skin.
struct SiteProfile {
  std::size_t channel = 0;
  double threshold = 0.0;  ///< faintest level that is felt, 0 to 1
  double ceiling = 0.0;    ///< strongest level that is comfortable; below the threshold: none is
  /// Which-one-was-it: how often each channel was named when this one vibrated. One row of the
  /// confusion table.
  std::array<std::uint32_t, wire::kTactorCount> named{};
};

/// A site that is recognised in less of its presentations than this is not used: a cue that is
/// misread is worse than none.
inline constexpr double kLeastRecognition = 0.5;
/// Two sites that are taken for each other in more than this get no phantom between them.
inline constexpr double kMostConfusion = 1.0 / 3.0;
/// Fewer presentations of a site say nothing.
inline constexpr std::uint32_t kLeastPresentations = 3;

struct LearnerProfile {
  std::string body_map;
  std::vector<SiteProfile> sites;

  /// Reads body_map and [[site]] channel, threshold, ceiling, named (16 counts).
  /// @throws std::runtime_error naming file, line, field and what was expected.
  static LearnerProfile load(const std::filesystem::path& file);
  /// Written beside the file first and then put in its place. @throws std::runtime_error
  void save(const std::filesystem::path& file) const;

  /// The map as this learner feels it: their thresholds; their ceilings, but never above the map's;
  /// without the sites that they do not feel or recognise; no phantom between sites that they
  /// confuse. Sites that the profile does not name stay as they are.
  /// @throws std::runtime_error for a profile of another map, and if no tactor is left
  BodyMap shape(BodyMap map) const;
};

/// Share of its presentations in which a site was recognised; 1 if there were too few to say.
double recognition(const SiteProfile& site) noexcept;
/// Share of both sites' presentations in which one was taken for the other.
double confusion(const SiteProfile& a, const SiteProfile& b) noexcept;

}  // namespace secondskin::coach
