#pragma once

#include <memory>
#include <optional>
#include <thread>

#include "server/optical/optical_source.h"
#include "sim/optical/suit_scene.h"
#include "sim/optical/virtual_tags.h"

/// A whole optical system of software: a body that moves by a motion, in a suit, between virtual
/// projectors; its tags on pseudo-terminals, read as real ones are. `sim:FILE` as a SOURCE.
namespace secondskin::cli {

/// What is known of virtual hardware without calibrating it.
server::ProjectorRig true_calibration(const std::vector<sim::VirtualProjector>& projectors);
server::MarkerBody true_body(const sim::SuitScene& scene, const Suit& suit);

/// How the paper's radio link behaves (2.3): 15 ms, some of it uncertain.
sim::TagLink paper_link();

class VirtualSuit final : public server::PoseSource {
 public:
  /// @param motion  canonical; kept over the middle of the tracking volume
  VirtualSuit(Motion motion, const Suit& suit);
  ~VirtualSuit() override;

  const Skeleton& skeleton() const override { return source_->skeleton(); }
  double rate_hz() const override { return source_->rate_hz(); }
  /// Ends when the motion has.
  server::Next next(StampedPose& pose) override;
  bool rewind() override { return false; }
  bool live() const override { return true; }

  server::OpticalSource& optical() noexcept { return *source_; }

 private:
  sim::SuitScene scene_;
  sim::VirtualRig rig_;
  std::optional<sim::VirtualTagsRunner> tags_;
  std::unique_ptr<server::OpticalSource> source_;
  std::uint64_t last_frame_;
  std::jthread thread_;
};

}  // namespace secondskin::cli
