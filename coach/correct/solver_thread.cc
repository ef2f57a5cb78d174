#include "coach/correct/solver_thread.h"

#include <ctime>
#include <utility>

namespace secondskin::coach {
namespace {

// Who may touch the buffers: the live path in kIdle (writes the problem) and kDone (reads the
// result), the solver in kPosted and kSolving. Each hands over by storing the next state.
enum Turn : int { kIdle, kPosted, kSolving, kDone, kEnding };

double thread_cpu_time() noexcept {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

}  // namespace

struct SolverThread::State {
  State(std::shared_ptr<const Reference> reference, const Skeleton& learner,
        const CorrectionOptions& options, const SolveLimit& solve_limit)
      : solver(std::move(reference), learner, options), limit(solve_limit) {
    problem.learner = Pose(kJointCount);  // so that a problem is copied without allocating
  }

  CorrectionSolver solver;
  SolveLimit limit;
  CorrectionProblem problem;
  CorrectionResult result;
  std::atomic<int> turn{kIdle};
  std::atomic<double> cpu_time{0.0};
  std::jthread thread;  // last: ends before what it uses

  void run() noexcept {
    for (;;) {
      int now = turn.load(std::memory_order_acquire);
      if (now == kEnding) return;
      if (now != kPosted) {
        turn.wait(now, std::memory_order_acquire);
        continue;
      }
      // Either exchange fails only because the owner wants to end.
      if (!turn.compare_exchange_strong(now, kSolving, std::memory_order_acq_rel)) return;
      const double before = thread_cpu_time();
      result = solver.solve(problem, limit);
      cpu_time.store(cpu_time.load(std::memory_order_relaxed) + thread_cpu_time() - before,
                     std::memory_order_relaxed);
      int solving = kSolving;
      if (!turn.compare_exchange_strong(solving, kDone, std::memory_order_acq_rel)) return;
    }
  }
};

SolverThread::SolverThread(std::shared_ptr<const Reference> reference, const Skeleton& learner,
                           const CorrectionOptions& options, const SolveLimit& limit)
    : state_(std::make_unique<State>(std::move(reference), learner, options, limit)) {
  state_->thread = std::jthread([state = state_.get()] { state->run(); });
}

SolverThread::~SolverThread() {
  state_->turn.store(kEnding, std::memory_order_release);
  state_->turn.notify_one();
}

std::optional<CorrectionResult> SolverThread::take(std::uint64_t) {
  if (state_->turn.load(std::memory_order_acquire) != kDone) return std::nullopt;
  const CorrectionResult result = state_->result;
  state_->turn.store(kIdle, std::memory_order_release);
  return result;
}

bool SolverThread::idle() const { return state_->turn.load(std::memory_order_acquire) == kIdle; }

void SolverThread::post(const CorrectionProblem& problem) {
  if (!idle()) return;
  state_->problem = problem;
  state_->turn.store(kPosted, std::memory_order_release);
  state_->turn.notify_one();
}

double SolverThread::cpu_time() const noexcept {
  return state_->cpu_time.load(std::memory_order_relaxed);
}

}  // namespace secondskin::coach
