#include "motion/skeleton.h"

#include <fmt/format.h>

#include <cmath>
#include <stdexcept>
#include <unordered_set>
#include <utility>

namespace secondskin {

Skeleton::Skeleton(std::vector<Segment> segments) : segments_(std::move(segments)) {
  if (segments_.empty()) throw std::invalid_argument("skeleton: no segments");
  std::unordered_set<std::string_view> names;
  for (std::size_t i = 0; i < segments_.size(); ++i) {
    const Segment& s = segments_[i];
    const auto fail = [&](std::string_view what) {
      throw std::invalid_argument(fmt::format("skeleton: segment {} \"{}\": {}", i, s.name, what));
    };
    if (s.name.empty()) fail("has no name");
    if (!names.insert(s.name).second) fail("name is used twice");
    if (i == 0 && s.parent) fail("is first and must be the root, but has a parent");
    if (i > 0 && !s.parent) fail("has no parent, but only the first segment may be the root");
    if (s.parent && *s.parent >= i) fail("parent does not come before it");
    if (!s.p_PB.allFinite() || !s.p_BE.allFinite() || !s.p_BC.allFinite()) {
      fail("an offset is not finite");
    }
    if (!std::isfinite(s.mass_fraction) || s.mass_fraction < 0.0) {
      fail("mass fraction is not a number of at least 0");
    }
  }
}

std::optional<std::size_t> Skeleton::find(std::string_view name) const noexcept {
  for (std::size_t i = 0; i < segments_.size(); ++i) {
    if (segments_[i].name == name) return i;
  }
  return std::nullopt;
}

Pose::Pose(std::size_t segments)
    : q_PB(segments, Eigen::Quaterniond::Identity()), confidence(segments, 1.0F) {}

bool Pose::is_valid() const noexcept {
  if (!p_WR.allFinite() || confidence.size() != q_PB.size()) return false;
  for (const Eigen::Quaterniond& q : q_PB) {
    // The negated comparison also refuses NaN.
    if (!(std::abs(q.norm() - 1.0) <= 1e-3)) return false;
  }
  for (const float c : confidence) {
    if (!(c >= 0.0F && c <= 1.0F)) return false;
  }
  return true;
}

}  // namespace secondskin
