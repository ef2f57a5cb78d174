#include "server/optical/optical_source.h"

#include <fmt/format.h>

#include <stdexcept>

namespace secondskin::server {

OpticalSource::OpticalSource(std::unique_ptr<OpticalReceiver> receiver, const ProjectorRig& rig,
                             const Suit& suit, const MarkerBody& body)
    : receiver_(std::move(receiver)),
      skeleton_(body.skeleton),
      tracker_(rig, segments_of(suit)),
      fit_(body) {
  for (const auto& detector : suit.detectors) names_.push_back(detector.name);
  if (receiver_->detectors() != names_.size()) {
    throw std::runtime_error(fmt::format("{} detectors in the suit, {} in the stream",
                                         names_.size(), receiver_->detectors()));
  }
  if (receiver_->projectors() != rig.size()) {
    throw std::runtime_error(fmt::format("{} projectors in the calibration, {} in the stream",
                                         rig.size(), receiver_->projectors()));
  }
  for (const Attachment& attachment : body.attachments) {
    if (attachment.marker >= names_.size() || names_[attachment.marker] != attachment.name) {
      throw std::runtime_error(
          fmt::format("the body was measured with another suit: its marker {} is '{}'{}",
                      attachment.marker, attachment.name,
                      attachment.marker < names_.size()
                          ? fmt::format(", the suit's '{}'", names_[attachment.marker])
                          : ", which the suit does not have"));
    }
  }
}

std::vector<std::size_t> segments_of(const Suit& suit) {
  std::vector<std::size_t> segments;
  for (const auto& detector : suit.detectors) segments.push_back(index(detector.segment));
  return segments;
}

double OpticalSource::rate_hz() const {
  return 1e9 / static_cast<double>(wire::cycle_ns(receiver_->projectors()));
}

Next OpticalSource::next(StampedPose& pose) {
  while (true) {
    const Next next = receiver_->next(values_);
    if (next != Next::kPose) {
      if (observer_) observer_(*this, next);
      return next;
    }
    tracker_.update(values_, points_);
    stamp_ns_ = values_.stamp_ns + wire::cycle_ns(receiver_->projectors());
    const double cycles = last_cycle_ ? static_cast<double>(values_.cycle - *last_cycle_) : 1.0;
    last_cycle_ = values_.cycle;
    pose.frame = values_.cycle + 1;
    pose.stamp_ns = stamp_ns_;
    const auto result = fit_.update(points_, cycles / rate_hz(), pose.pose);
    if (observer_) observer_(*this, next);
    started_ = started_ || result.tracked;
    if (started_) return Next::kPose;
  }
}

}  // namespace secondskin::server
