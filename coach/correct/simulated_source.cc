#include "coach/correct/simulated_source.h"

#include <utility>

namespace secondskin::coach {

SimulatedSource::SimulatedSource(std::shared_ptr<const Reference> reference,
                                 const Skeleton& learner, const CorrectionOptions& options,
                                 std::uint64_t frames, std::uint32_t iterations)
    : solver_(std::move(reference), learner, options), frames_(frames), iterations_(iterations) {}

std::optional<CorrectionResult> SimulatedSource::take(std::uint64_t frame) {
  if (!result_ || frame < result_->frame + frames_) return std::nullopt;
  return std::exchange(result_, std::nullopt);
}

void SimulatedSource::post(const CorrectionProblem& problem) {
  if (!idle()) return;
  result_ = solver_.solve(problem, {.iterations = iterations_});
  result_->frame = problem.frame;
}

}  // namespace secondskin::coach
