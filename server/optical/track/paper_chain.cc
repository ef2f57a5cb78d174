#include "server/optical/track/paper_chain.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "wire/photo_tag.h"

namespace secondskin::server {

PaperChain::PaperChain(const ProjectorRig& rig, std::size_t detectors,
                       const PaperChainOptions& options)
    : rig_(rig),
      detectors_(detectors),
      options_(options),
      no_values_(detectors * rig.size(), wire::kNoValue),
      filtered_(no_values_),
      used_(rig.size()) {
  if (!(options.variance_limit > 0.0)) {
    throw std::invalid_argument(
        fmt::format("variance_limit: expected more than 0, found {}", options.variance_limit));
  }
  if (options.value_filter) filter_.emplace(detectors, rig.size(), *options.value_filter);
  if (options.smoother) smoothers_.assign(detectors, PointSmoother(*options.smoother));
  const std::size_t window = options.smoother ? options.smoother->window : 1;
  sigmas_.resize(detectors * (window / 2 + 1));
  memory_ = window + (options.value_filter ? options.value_filter->history : 0);
  planes_.reserve(rig.size());
}

std::size_t PaperChain::delay_frames() const noexcept {
  return (filter_ ? filter_->delay_frames() : 0) +
         (options_.smoother ? options_.smoother->window / 2 : 0);
}

void PaperChain::step(std::span<const std::uint8_t> values, std::int64_t stamp_ns,
                      MarkerFrame& out) noexcept {
  if (filter_) {
    filter_->update(values, filtered_);
    values = filtered_;
  }
  const std::size_t n = rig_.size();
  const std::size_t waiting = sigmas_.size() / std::max<std::size_t>(detectors_, 1);
  newest_ = (newest_ + 1) % waiting;
  for (std::size_t d = 0; d < detectors_; ++d) {
    planes_.clear();
    for (std::size_t p = 0; p < n; ++p) {
      const std::uint8_t value = values[d * n + p];
      if (value != wire::kNoValue && rig_.projectors[p]) {
        planes_.push_back(rig_.projectors[p]->plane(value));
      }
    }
    const auto solved = options_.row_removal
                            ? intersect_filtered(planes_, std::sqrt(options_.variance_limit),
                                                 std::span(used_).first(planes_.size()))
                            : intersect(planes_);
    std::optional<Eigen::Vector3d> p_W;
    if (solved) p_W = solved->p_W;
    sigmas_[newest_ * detectors_ + d] = solved ? static_cast<float>(solved->sigma) : 0.0F;
    if (!smoothers_.empty()) p_W = smoothers_[d].update(stamp_ns, p_W);
    out.visible[d] = p_W ? 1 : 0;
    out.p_WM[d] = p_W.value_or(Eigen::Vector3d::Zero());
    out.residual[d] = p_W ? sigmas_[((newest_ + 1) % waiting) * detectors_ + d] : 0.0F;
  }
}

void PaperChain::update(const ProjectorFrame& frame, MarkerFrame& out) noexcept {
  if (out.p_WM.size() != detectors_ || out.visible.size() != detectors_ ||
      out.residual.size() != detectors_) {
    out = MarkerFrame(detectors_);
  }
  const bool forward = cycle_ && frame.cycle > *cycle_;
  const std::uint64_t lost = !cycle_ ? 0 : forward ? frame.cycle - *cycle_ - 1 : memory_;
  cycle_ = frame.cycle;
  for (std::uint64_t k = std::min<std::uint64_t>(lost, memory_); k > 0; --k) {
    step(no_values_, frame.stamp_ns - static_cast<std::int64_t>(k) * wire::cycle_ns(rig_.size()),
         out);
  }
  const bool fits = frame.detectors == detectors_ && frame.projectors == rig_.size() &&
                    frame.values.size() == no_values_.size();
  step(fits ? std::span(frame.values) : std::span(no_values_), frame.stamp_ns, out);
}

}  // namespace secondskin::server
