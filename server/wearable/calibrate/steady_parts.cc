#include "server/wearable/calibrate/steady_parts.h"

namespace secondskin::server {

void SteadyParts::add(const wire::InertialCode& code) {
  for (std::size_t i = 0; i < wire::kInertialChannels; ++i) {
    sum_[static_cast<Eigen::Index>(i)] += code.values[i];
    hit_end_ = hit_end_ || code.values[i] == 0 || code.values[i] == wire::kValueCodes - 1;
  }
  if (++in_window_ < kWindow) return;
  windows_.push_back(sum_ / static_cast<double>(kWindow));
  saturated_.push_back(hit_end_);
  sum_.setZero();
  in_window_ = 0;
  hit_end_ = false;
}

std::vector<SteadyPart> SteadyParts::parts() const {
  std::vector<SteadyPart> parts;
  for (std::size_t begin = 0; begin < windows_.size();) {
    std::size_t end = begin + 1;
    while (end < windows_.size() && !saturated_[end] && !saturated_[end - 1] &&
           (windows_[end] - windows_[end - 1]).cwiseAbs().maxCoeff() <= kSteady) {
      ++end;
    }
    if (end - begin >= kLeastWindows) {
      SteadyPart part{CodeVector::Zero(), (end - begin - 2) * kWindow};
      for (std::size_t w = begin + 1; w + 1 < end; ++w) part.mean += windows_[w];
      part.mean /= static_cast<double>(end - begin - 2);
      parts.push_back(part);
    }
    begin = end;
  }
  return parts;
}

}  // namespace secondskin::server
