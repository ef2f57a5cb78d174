#include "clients/cli/virtual_suit.h"

#include <cmath>

#include "server/open_source.h"

namespace secondskin::cli {
namespace {

constexpr std::uint64_t kSeed = 1;
constexpr double kSkinSigma = 0.008;  // as MarkerPlace::sway [m]

}  // namespace

server::ProjectorRig true_calibration(const std::vector<sim::VirtualProjector>& projectors) {
  server::ProjectorRig rig;
  for (const auto& projector : projectors) rig.projectors.push_back({{projector.matrix()}});
  return rig;
}

server::MarkerBody true_body(const sim::SuitScene& scene, const Suit& suit) {
  server::MarkerBody body{scene.skeleton(), {}};
  for (std::size_t d = 0; d < suit.detectors.size(); ++d) {
    body.attachments.push_back(
        {d, suit.detectors[d].name, scene.segment(d), scene.place(d).p_BS, kSkinSigma});
  }
  return body;
}

sim::TagLink paper_link() {
  sim::TagLink link;
  link.latency = 0.005;
  link.jitter = 0.010;
  return link;
}

VirtualSuit::VirtualSuit(Motion motion, const Suit& suit)
    : scene_(sim::recentred(motion), suit),
      rig_(sim::second_skin_rig(), scene_, sim::OpticalNoise{}, kSeed) {
  tags_.emplace(rig_, sim::tag_sizes(suit), paper_link(), kSeed);
  std::vector<std::string> ports;
  for (std::size_t tag = 0; tag < tags_->tags(); ++tag) ports.push_back(tags_->path(tag));
  const auto calibration = true_calibration(rig_.projectors());
  auto receiver = std::make_unique<server::OpticalReceiver>(
      ports, server::format_of(suit, calibration.size(), false));
  source_ = std::make_unique<server::OpticalSource>(std::move(receiver), calibration, suit,
                                                    true_body(scene_, suit));
  last_frame_ = static_cast<std::uint64_t>(std::ceil(motion.duration() * source_->rate_hz()));
}

VirtualSuit::~VirtualSuit() = default;

server::Next VirtualSuit::next(StampedPose& pose) {
  // The body begins to move when somebody looks, so that nobody misses its beginning.
  if (!thread_.joinable()) {
    thread_ = std::jthread([this](std::stop_token stop) { tags_->run(stop); });
  }
  const auto next = source_->next(pose);
  return next == server::Next::kPose && pose.frame > last_frame_ ? server::Next::kEnd : next;
}

}  // namespace secondskin::cli
