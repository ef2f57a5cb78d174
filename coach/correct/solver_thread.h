#pragma once

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <thread>

#include "coach/correct/correction.h"

/// Runs a CorrectionSolver beside the live path, which never waits for it.
namespace secondskin::coach {

/// Who solves, as the coach sees it: the live thread, or a replay of what it did.
class CorrectionSource {
 public:
  virtual ~CorrectionSource() = default;
  /// The result that is handed over at this frame, if one is.
  virtual std::optional<CorrectionResult> take(std::uint64_t frame) = 0;
  /// Whether a problem posed now would be accepted: nothing under way and nothing left to take.
  virtual bool idle() const = 0;
  virtual void post(const CorrectionProblem& problem) = 0;
};

/// The live one. One problem under way at a time; the coach poses the newest when it is idle, so
/// the newest problem always wins and each result is taken exactly once. take, idle and post
/// neither block on the solve nor allocate.
class SolverThread final : public CorrectionSource {
 public:
  SolverThread(std::shared_ptr<const Reference> reference, const Skeleton& learner,
               const CorrectionOptions& options, const SolveLimit& limit = {});
  ~SolverThread() override;  ///< lets the solve under way reach its deadline, then joins

  std::optional<CorrectionResult> take(std::uint64_t frame) override;
  bool idle() const override;
  void post(const CorrectionProblem& problem) override;

  double cpu_time() const noexcept;  ///< processor time that the solves took so far [s]

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::coach
