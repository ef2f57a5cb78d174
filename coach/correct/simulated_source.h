#pragma once

#include <optional>

#include "coach/correct/solver_thread.h"

/// The solver in simulated time: without a thread or a deadline, so the same poses give the same
/// results whatever the machine.
namespace secondskin::coach {

/// Solves a problem when it is posed and hands the result over some frames later. One thread.
class SimulatedSource final : public CorrectionSource {
 public:
  /// @param frames      from the frame that posed a problem to the one that gets its result, >= 1
  /// @param iterations  of the solver at most, in the place of a deadline
  SimulatedSource(std::shared_ptr<const Reference> reference, const Skeleton& learner,
                  const CorrectionOptions& options, std::uint64_t frames = 1,
                  std::uint32_t iterations = 30);

  std::optional<CorrectionResult> take(std::uint64_t frame) override;
  bool idle() const override { return !result_; }
  void post(const CorrectionProblem& problem) override;

 private:
  CorrectionSolver solver_;
  std::uint64_t frames_;
  std::uint32_t iterations_;
  std::optional<CorrectionResult> result_;
};

/// Never has a result: a coach whose cues do not come from the learner's own error.
class NoSource final : public CorrectionSource {
 public:
  std::optional<CorrectionResult> take(std::uint64_t) override { return std::nullopt; }
  bool idle() const override { return false; }
  void post(const CorrectionProblem&) override {}
};

}  // namespace secondskin::coach
