#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "coach/correct/correction_model.h"

/// Which few joints to ask: the combinatorial half of the correction, docs/correction.md. Pure and
/// deterministic; the amounts that come with the choice are a start for the solver.
namespace secondskin::coach {

/// Chooses at most so many joints that lower a posed model's cost most, with the best amounts of
/// the chosen taken into account: all sets of one and two by the Gauss-Newton model at no
/// correction, the best of them again by the model's own cost; further joints one by one.
class JointSelection {
 public:
  explicit JointSelection(CorrectionModel& model);

  /// Chooses among the model's open joints, and leaves only the chosen open.
  /// @param most      how many at most
  /// @param previous  the last choice: kept unless another is clearly better
  /// @param delta     out: amounts for the chosen, inside the bounds, 0 elsewhere [rad]
  JointSet select(std::size_t most, const JointSet& previous, std::span<double> delta);

  /// The best amounts for these joints among the model's open ones, by so many Newton steps.
  /// @returns the cost; a centre of mass beyond the support costs too
  double amounts(const JointSet& joints, int steps, std::span<double> delta);

 private:
  struct Candidate {
    JointSet joints;
    double value;  ///< cost above that of no correction, with the price of asking
  };

  double quadratic(const JointSet& joints);
  void grow(const JointSet& open, std::size_t most, Candidate& set);
  double refine(const JointSet& joints, int steps);
  double augmented(std::span<const double> delta);
  void augmented_model(std::span<const double> delta);

  CorrectionModel* model_;
  std::vector<double> gradient_, hessian_;  ///< at no correction
  std::vector<double> gradient_here_, hessian_here_;
  std::vector<double> balance_, jacobian_;
  std::vector<double> amounts_, trial_, next_;  ///< like delta
  std::vector<Candidate> candidates_;
};

}  // namespace secondskin::coach
