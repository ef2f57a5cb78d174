#include "coach/score/offline.h"

#include <numeric>
#include <utility>

#include "coach/align/expert_average.h"

namespace secondskin::coach {
namespace {

using Repetitions = std::vector<RepetitionScore>;

Repetitions follow(const std::shared_ptr<const Reference>& reference,
                   std::span<const StampedPose> poses) {
  Aligner aligner(reference);
  RepetitionScorer scorer(reference);
  JointVectors error = zero_vectors();
  Repetitions found;
  for (const StampedPose& pose : poses) {
    const AlignmentEstimate e = aligner.update(pose.stamp_ns, pose.pose);
    if (!pose.pose.is_valid()) continue;
    joint_errors(*reference, e.reference_time, pose.pose, error);
    if (auto score = scorer.update(pose.stamp_ns, pose.pose, e, error, 0)) found.push_back(*score);
  }
  if (auto score = scorer.finish()) found.push_back(*score);
  return found;
}

Repetitions warp(const std::shared_ptr<const Reference>& reference,
                 std::span<const StampedPose> poses) {
  std::vector<const StampedPose*> valid;
  for (const StampedPose& pose : poses) {
    if (pose.pose.is_valid()) valid.push_back(&pose);
  }
  if (valid.size() < 2 || valid.back()->stamp_ns <= valid.front()->stamp_ns) return {};
  const double seconds =
      1e-9 * static_cast<double>(valid.back()->stamp_ns - valid.front()->stamp_ns);
  // Warping compares rotations, so whose skeleton it is does not matter.
  Motion learner{reference->motion.skeleton, static_cast<double>(valid.size() - 1) / seconds, {}};
  for (const StampedPose* pose : valid) learner.poses.push_back(pose->pose);
  const std::vector<double> path = warp_onto(learner, reference->motion, reference->weight);
  RepetitionScorer scorer(reference);
  JointVectors error = zero_vectors();
  for (std::size_t i = 0; i < valid.size(); ++i) {
    const double time = path[i] / reference->motion.rate_hz;
    joint_errors(*reference, time, valid[i]->pose, error);
    (void)scorer.update(valid[i]->stamp_ns, valid[i]->pose, {time, 1.0, 1.0, Phase::kMoving, 1},
                        error, 0);
  }
  Repetitions found;
  if (auto score = scorer.finish()) found.push_back(*score);
  return found;
}

double mean_total(const Repetitions& repetitions) {
  const double sum = std::accumulate(repetitions.begin(), repetitions.end(), 0.0,
                                     [](double s, const auto& r) { return s + r.total; });
  return repetitions.empty() ? 0.0 : sum / static_cast<double>(repetitions.size());
}

template <class Score>
OfflineScore better_side(const std::shared_ptr<const Reference>& reference,
                         std::span<const StampedPose> poses, Score score) {
  OfflineScore result{score(reference, poses), false};
  if (!reference->either_side) return result;
  Repetitions other = score(std::make_shared<const Reference>(mirrored(*reference)), poses);
  if (std::pair(other.size(), mean_total(other)) >
      std::pair(result.repetitions.size(), mean_total(result.repetitions))) {
    result = {std::move(other), true};
  }
  return result;
}

}  // namespace

OfflineScore score_recording(const std::shared_ptr<const Reference>& reference,
                             std::span<const StampedPose> poses) {
  return better_side(reference, poses, follow);
}

OfflineScore score_whole(const std::shared_ptr<const Reference>& reference,
                         std::span<const StampedPose> poses) {
  return better_side(reference, poses, warp);
}

}  // namespace secondskin::coach
