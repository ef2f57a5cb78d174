#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>

#include "coach/correct/habit.h"
#include "coach/reference.h"

/// Which few joints, and where to: the correction as a nonlinear programme for Ipopt.
/// docs/correction.md derives it. Pure: a problem in, a result out; solver_thread.h runs it beside
/// the live path.
namespace secondskin::coach {

/// How far a correction looks ahead in the learner's time: human reaction [s].
inline constexpr double kHorizon = 0.3;

struct CorrectionProblem {
  std::uint64_t frame = 0;  ///< the sample it is posed from
  std::int64_t stamp_ns = 0;
  Pose learner;  ///< canonical; joints with confidence 0 are left alone
  JointVectors velocity =
      zero_vectors();           ///< angular velocity of each joint, in its own frame [rad/s]
  double reference_time = 0.0;  ///< [s]
  double tempo = 1.0;
  Habit habit{1.0};                     ///< what this learner usually gets wrong
  JointSet askable = JointSet().set();  ///< the others count, but are not asked to move
};

enum class SolverStatus : std::uint8_t { kNone, kConverged, kDeadline, kFallback };

struct CorrectionResult {
  std::uint64_t frame = 0;  ///< of the problem
  SolverStatus status = SolverStatus::kNone;
  JointVectors target =
      zero_vectors();  ///< correction asked of each joint; zero where left alone [rad]
  JointVectors expected = zero_vectors();     ///< error of each joint at the horizon's end, were
                                              ///< nothing said: what the target answers [rad]
  std::array<double, kJointCount> benefit{};  ///< share of the weighted error removed by it, 0 to 1
  double solve_time = 0.0;                    ///< [s]
  std::uint32_t iterations = 0;
};

struct CorrectionOptions {
  double horizon = kHorizon;     ///< look-ahead [s]
  double tolerance_scale = 1.0;  ///< of the reference's dead bands
  double sparsity = 1.0;         ///< price of asking one more joint to move; 0: none
  std::size_t max_joints = 2;    ///< at most so many are asked to move
};

/// When a solve has to end. The live coach gives a deadline; a replay gives the iterations that the
/// live solve had, so that it ends at the same point.
struct SolveLimit {
  double deadline = 0.015;                  ///< [s] from the start of the solve
  std::optional<std::uint32_t> iterations;  ///< set: ends exactly after so many, whatever the time
};

/// Error of each joint: rotation from the learner's to the reference's orientation, in the joint's
/// frame: log(q_PB_learner^-1 * q_PB_reference). The pelvis compares tilt only (no heading). Zero
/// for joints without confidence or weight.
void joint_errors(const Reference& reference, double reference_time, const Pose& learner,
                  JointVectors& error) noexcept;

/// One solver, one thread. Same sequence of problems and limits in, same results out, bit for bit.
class CorrectionSolver {
 public:
  /// Sets Ipopt up and solves once, so that the first live solve is warm.
  /// @throws std::runtime_error when Ipopt cannot be initialised.
  CorrectionSolver(std::shared_ptr<const Reference> reference, const Skeleton& learner,
                   const CorrectionOptions& options = {});
  ~CorrectionSolver();

  /// Never throws past its limits: an unconverged solve gives its last feasible iterate
  /// (kDeadline), a failed one the closed form (kFallback).
  CorrectionResult solve(const CorrectionProblem& problem, const SolveLimit& limit = {});

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::coach
