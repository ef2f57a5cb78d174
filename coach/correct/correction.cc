#include "coach/correct/correction.h"

#include <coin/IpDenseVector.hpp>
#include <coin/IpIpoptApplication.hpp>
#include <coin/IpIpoptCalculatedQuantities.hpp>
#include <coin/IpIpoptData.hpp>
#include <coin/IpTNLP.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <mutex>
#include <numbers>
#include <stdexcept>
#include <vector>

#include "coach/correct/correction_model.h"
#include "coach/correct/joint_selection.h"
#include "motion/rotation.h"

namespace secondskin::coach {
namespace {

using Ipopt::Index;
using Ipopt::Number;

// Optimality. The price of a radian is 1.7 and the curvature at least 30, so this is well inside a
// tenth of a degree.
constexpr double kTolerance = 3e-3;
constexpr double kFeasible = 1e-4;      // balance, [m]
constexpr double kBarrier = 3e-4;       // where a solve starts on the central path
constexpr double kSmallestRoom = 1e-4;  // a bound is never closer: no variable is ever fixed [rad]
constexpr std::uint32_t kMostIterations = 100;
constexpr Index kStuck = 25;  // so many in vain: the next solve starts cold
// A movement of the chosen joints that the selection moves by less than this pays most of the price
// [rad].
constexpr double kFewMovements = 1.0 * std::numbers::pi / 180.0;
constexpr double kStartPush = 1e-3;  // from the bounds, of a start that the selection gives [rad]

// MUMPS before Ipopt 3.14 is not safe in two threads of one process at once.
std::mutex& mumps_mutex() {
  static std::mutex mutex;
  return mutex;
}

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// The shortest rotation that takes one unit vector to another; about x or y where they are
// opposite.
Eigen::Vector3d shortest_turn(const Eigen::Vector3d& from, const Eigen::Vector3d& to) noexcept {
  const Eigen::Vector3d cross = from.cross(to);
  const double sine = cross.norm(), cosine = from.dot(to);
  if (sine > 1e-9) return cross * (std::atan2(sine, cosine) / sine);
  if (cosine > 0.0) return cross;
  const Eigen::Vector3d other =
      std::abs(from.x()) < 0.9 ? Eigen::Vector3d::UnitX() : Eigen::Vector3d::UnitY();
  return from.cross(other).normalized() * std::numbers::pi;
}

// Where an iteration stands, and where the next solve starts.
struct Iterate {
  std::vector<Number> x, lower_multipliers, upper_multipliers, lambda;
};

// The correction in Ipopt's terms: delta = positive - negative parts, each from 0 to its bound, and
// eight balance constraints if the learner stands.
class SplitProgramme final : public Ipopt::TNLP {
 public:
  explicit SplitProgramme(CorrectionModel& model)
      : model_(model),
        n_(model.size()),
        m_(model.constraints()),
        price_(n_, 0.0),
        delta_(n_, 0.0),
        gradient_(n_, 0.0),
        hessian_(n_ * n_, 0.0),
        jacobian_(m_ * n_, 0.0) {
    start_.x.assign(2 * n_, 0.0);
    start_.lower_multipliers.assign(2 * n_, 1.0);
    start_.upper_multipliers.assign(2 * n_, 1.0);
    start_.lambda.assign(m_, 0.0);
    current_ = start_;
    best_.assign(n_, 0.0);
    for (std::size_t i = 0; i < 2 * n_; ++i) {
      for (std::size_t j = 0; j <= i; ++j) {
        if (model_.coupled(i % n_, j % n_)) entries_.emplace_back(i, j);
      }
    }
  }

  /// @param selected  amounts that the selection found: what is small there costs more
  void begin(const SolveLimit& limit, std::chrono::steady_clock::time_point start,
             std::span<const double> selected) {
    limit_ = limit;
    began_ = start;
    for (std::size_t i = 0; i < n_; ++i) {
      price_[i] = model_.price() * kFewMovements / (kFewMovements + std::abs(selected[i]));
    }
    iteration_ = 0;
    converged_ = feasible_seen_ = false;
    std::fill(best_.begin(), best_.end(), 0.0);
    current_ = start_;
  }

  /// Starts where the selection ended, on the central path.
  void start_from(std::span<const double> selected) {
    for (std::size_t i = 0; i < 2 * n_; ++i) {
      const std::size_t k = i % n_;
      const double room = std::max(i < n_ ? model_.upper()[k] : -model_.lower()[k], kSmallestRoom);
      const double wanted = std::max(0.0, i < n_ ? selected[k] : -selected[k]);
      const double push = std::min(kStartPush, 0.5 * room);
      start_.x[i] = std::clamp(wanted, push, room - push);
      start_.lower_multipliers[i] = kBarrier / start_.x[i];
      start_.upper_multipliers[i] = kBarrier / (room - start_.x[i]);
    }
  }
  void keep_for_next() { start_ = current_; }
  void forget_balance() { std::fill(start_.lambda.begin(), start_.lambda.end(), 0.0); }

  bool converged() const { return converged_; }
  bool feasible_seen() const { return feasible_seen_; }
  Index iteration() const { return iteration_; }
  std::span<const double> best() const {
    return best_;
  }  ///< last feasible delta, inside its bounds

  bool get_nlp_info(Index& n, Index& m, Index& nnz_jac_g, Index& nnz_h_lag,
                    IndexStyleEnum& style) override {
    const auto all = static_cast<Index>(2 * n_);
    n = all;
    m = static_cast<Index>(m_);
    nnz_jac_g = m * all;
    nnz_h_lag = static_cast<Index>(entries_.size());
    style = C_STYLE;
    return true;
  }

  bool get_bounds_info(Index, Number* x_l, Number* x_u, Index, Number* g_l, Number* g_u) override {
    for (std::size_t i = 0; i < n_; ++i) {
      x_l[i] = x_l[n_ + i] = 0.0;
      x_u[i] = std::max(model_.upper()[i], kSmallestRoom);
      x_u[n_ + i] = std::max(-model_.lower()[i], kSmallestRoom);
    }
    for (std::size_t c = 0; c < m_; ++c) {
      g_l[c] = -2e19;
      g_u[c] = model_.balance_limit()[c];
    }
    return true;
  }

  bool get_starting_point(Index, bool init_x, Number* x, bool init_z, Number* z_L, Number* z_U,
                          Index, bool init_lambda, Number* lambda) override {
    if (init_x) std::copy(start_.x.begin(), start_.x.end(), x);
    if (init_z) {
      std::copy(start_.lower_multipliers.begin(), start_.lower_multipliers.end(), z_L);
      std::copy(start_.upper_multipliers.begin(), start_.upper_multipliers.end(), z_U);
    }
    if (init_lambda) std::copy(start_.lambda.begin(), start_.lambda.end(), lambda);
    return true;
  }

  bool eval_f(Index, const Number* x, bool, Number& value) override {
    read(x);
    value = model_.cost(delta_);
    for (std::size_t i = 0; i < n_; ++i) value += price_[i] * (x[i] + x[n_ + i]);
    return std::isfinite(value);
  }

  bool eval_grad_f(Index, const Number* x, bool, Number* grad) override {
    read(x);
    model_.gradient(delta_, gradient_);
    for (std::size_t i = 0; i < n_; ++i) {
      grad[i] = price_[i] + gradient_[i];
      grad[n_ + i] = price_[i] - gradient_[i];
    }
    return true;
  }

  bool eval_g(Index, const Number* x, bool, Index, Number* g) override {
    read(x);
    model_.balance(delta_, {g, m_});
    return true;
  }

  bool eval_jac_g(Index, const Number* x, bool, Index, Index, Index* row, Index* column,
                  Number* values) override {
    std::size_t at = 0;
    if (values != nullptr) {
      read(x);
      model_.balance_jacobian(delta_, jacobian_);
    }
    for (std::size_t c = 0; c < m_; ++c) {
      for (std::size_t i = 0; i < 2 * n_; ++i, ++at) {
        if (values == nullptr) {
          row[at] = static_cast<Index>(c);
          column[at] = static_cast<Index>(i);
        } else {
          values[at] = i < n_ ? jacobian_[c * n_ + i] : -jacobian_[c * n_ + i - n_];
        }
      }
    }
    return true;
  }

  bool eval_h(Index, const Number* x, bool, Number factor, Index, const Number* lambda, bool, Index,
              Index* row, Index* column, Number* values) override {
    if (values != nullptr) {
      read(x);
      model_.exact_hessian(delta_, factor, {lambda, m_}, hessian_);
    }
    for (std::size_t e = 0; e < entries_.size(); ++e) {
      const auto [i, j] = entries_[e];
      if (values == nullptr) {
        row[e] = static_cast<Index>(i);
        column[e] = static_cast<Index>(j);
      } else {
        const double sign = (i < n_) == (j < n_) ? 1.0 : -1.0;
        values[e] = sign * hessian_[i % n_ * n_ + j % n_];
      }
    }
    return true;
  }

  // Ipopt calls this before its own test of convergence, so that a live solve which converges at
  // iteration N and a replay limited to N see the same iterate and come to the same verdict.
  bool intermediate_callback(Ipopt::AlgorithmMode mode, Index iteration, Number, Number, Number,
                             Number, Number, Number, Number, Number, Index,
                             const Ipopt::IpoptData* data,
                             Ipopt::IpoptCalculatedQuantities* quantities) override {
    iteration_ = iteration;
    if (mode == Ipopt::RegularMode && data != nullptr && quantities != nullptr) {
      copy(*data->curr()->x(), current_.x);
      copy(*data->curr()->z_L(), current_.lower_multipliers);
      copy(*data->curr()->z_U(), current_.upper_multipliers);
      if (m_ > 0) copy(*data->curr()->y_d(), current_.lambda);
      if (quantities->curr_nlp_constraint_violation(Ipopt::NORM_MAX) <= kFeasible) {
        feasible_seen_ = true;
        for (std::size_t i = 0; i < n_; ++i) {
          best_[i] =
              std::clamp(current_.x[i] - current_.x[n_ + i], model_.lower()[i], model_.upper()[i]);
        }
      }
      if (quantities->curr_nlp_error() <= kTolerance) {
        converged_ = true;
        return true;
      }
    }
    const bool late = !limit_.iterations && !(seconds_since(began_) < limit_.deadline);
    const std::uint32_t most =
        std::min(limit_.iterations.value_or(kMostIterations), kMostIterations);
    return !late && static_cast<std::uint32_t>(iteration) < most;
  }

  void finalize_solution(Ipopt::SolverReturn, Index, const Number*, const Number*, const Number*,
                         Index, const Number*, const Number*, Number, const Ipopt::IpoptData*,
                         Ipopt::IpoptCalculatedQuantities*) override {}

 private:
  void read(const Number* x) {
    for (std::size_t i = 0; i < n_; ++i) delta_[i] = x[i] - x[n_ + i];
  }

  // Every variable has both bounds and none is fixed, so Ipopt's vectors are in our order.
  static void copy(const Ipopt::Vector& from, std::vector<Number>& to) {
    const auto* dense = dynamic_cast<const Ipopt::DenseVector*>(&from);
    if (dense == nullptr || static_cast<std::size_t>(dense->Dim()) != to.size()) return;
    if (dense->IsHomogeneous()) {
      std::fill(to.begin(), to.end(), dense->Scalar());
    } else {
      std::copy_n(dense->Values(), to.size(), to.begin());
    }
  }

  CorrectionModel& model_;
  std::size_t n_, m_;
  std::vector<double> price_, delta_, gradient_, hessian_, jacobian_;
  std::vector<std::pair<std::size_t, std::size_t>> entries_;  ///< of the Hessian's lower triangle
  Iterate start_, current_;
  std::vector<double> best_;
  SolveLimit limit_;
  std::chrono::steady_clock::time_point began_;
  Index iteration_ = 0;
  bool converged_ = false, feasible_seen_ = false;
};

}  // namespace

void joint_errors(const Reference& reference, double reference_time, const Pose& learner,
                  JointVectors& error) noexcept {
  const auto& poses = reference.motion.poses;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    error[j].setZero();
    if (j >= learner.q_PB.size() || j >= learner.confidence.size()) continue;
    const Eigen::Quaterniond& q = learner.q_PB[j];
    if (!(learner.confidence[j] > 0.0f) || !(reference.weight[j] > 0.0)) continue;
    if (!q.coeffs().allFinite() || !std::isfinite(reference_time)) continue;
    const double at = std::clamp(reference_time * reference.motion.rate_hz, 0.0,
                                 static_cast<double>(poses.size() - 1));
    const Pose& nearest = poses[std::min(static_cast<std::size_t>(at + 0.5), poses.size() - 1)];
    if (j < nearest.confidence.size() && !(nearest.confidence[j] > 0.0f)) continue;
    const Eigen::Quaterniond q_ref = reference_rotation(reference, reference_time, j);
    if (j == index(Joint::kPelvis)) {
      // The turn that takes the learner's vertical, seen from the pelvis, onto the expert's.
      const Eigen::Vector3d up = q.conjugate() * Eigen::Vector3d::UnitZ();
      const Eigen::Vector3d up_ref = q_ref.conjugate() * Eigen::Vector3d::UnitZ();
      error[j] = shortest_turn(up_ref, up);
    } else {
      error[j] = rotation_vector(q.conjugate() * q_ref);
    }
  }
}

struct CorrectionSolver::State {
  State(std::shared_ptr<const Reference> reference, const Skeleton& learner,
        const CorrectionOptions& options)
      : model(std::move(reference), learner, options),
        selection(model),
        programme(new SplitProgramme(model)),
        most(options.max_joints) {
    delta.assign(model.size(), 0.0);
    selected.assign(model.size(), 0.0);
    fallback.assign(model.size(), 0.0);
    alone.assign(model.size(), 0.0);
  }

  CorrectionModel model;
  JointSelection selection;
  JointSet asked;  ///< by the last solve
  Ipopt::SmartPtr<SplitProgramme> programme;
  Ipopt::SmartPtr<Ipopt::IpoptApplication> application;
  std::size_t most;
  bool warm = false;
  std::vector<double> delta, selected, fallback, alone;

  void set_up();
  void report(CorrectionResult& result);
};

void CorrectionSolver::State::set_up() {
  // Not IpoptApplicationFactory: this constructor makes no console journal and reads no ipopt.opt.
  application = new Ipopt::IpoptApplication(false);
  const auto options = application->Options();
  bool set = true;
  const auto text = [&](const char* name, const char* value) {
    set = options->SetStringValue(name, value) && set;
  };
  const auto number = [&](const char* name, double value) {
    set = options->SetNumericValue(name, value) && set;
  };
  const auto whole = [&](const char* name, Index value) {
    set = options->SetIntegerValue(name, value) && set;
  };
  whole("print_level", 0);
  text("sb", "yes");
  text("linear_solver", "mumps");
  text("mu_strategy", "monotone");
  text("nlp_scaling_method", "none");
  text("hessian_approximation", "exact");
  number("tol", kTolerance);
  number("constr_viol_tol", kFeasible);
  number("dual_inf_tol", 1e10);  // curr_nlp_error() <= tol alone decides, here as in the callback
  number("compl_inf_tol", 1e10);
  whole("acceptable_iter", 0);
  whole("max_iter", 2 * kMostIterations);  // the callback stops before
  number("bound_relax_factor", 0.0);       // bounds hold exactly at every iterate
  text("warm_start_init_point", "yes");
  number("mu_init", kBarrier);
  number("warm_start_bound_push", 1e-3);
  number("warm_start_bound_frac", 1e-3);
  number("warm_start_slack_bound_push", 1e-3);
  number("warm_start_slack_bound_frac", 1e-3);
  number("warm_start_mult_bound_push", 1e-3);
  // One small matrix in well-scaled units: no scaling, no costly search for an order.
  whole("mumps_permuting_scaling", 0);
  whole("mumps_scaling", 0);
  whole("mumps_pivot_order", 0);  // approximate minimum degree
  whole("min_refinement_steps", 0);
  if (!set || application->Initialize("") != Ipopt::Solve_Succeeded) {
    throw std::runtime_error("CorrectionSolver: Ipopt refuses its options");
  }
}

void CorrectionSolver::State::report(CorrectionResult& result) {
  model.targets(delta, result.target);
  std::fill(alone.begin(), alone.end(), 0.0);
  const double before = model.error(alone);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    result.benefit[j] = 0.0;
    if (result.target[j].isZero()) continue;
    result.expected[j] = model.expected_error(j);
    if (!(before > 0.0)) continue;
    std::fill(alone.begin(), alone.end(), 0.0);
    const auto freedoms = model.freedoms();
    for (std::size_t i = 0; i < freedoms.size(); ++i) {
      if (index(freedoms[i].joint) == j) alone[i] = delta[i];
    }
    result.benefit[j] = std::clamp((before - model.error(alone)) / before, 0.0, 1.0);
  }
}

CorrectionSolver::CorrectionSolver(std::shared_ptr<const Reference> reference,
                                   const Skeleton& learner, const CorrectionOptions& options)
    : state_(std::make_unique<State>(std::move(reference), learner, options)) {
  state_->set_up();
  // The first solve of a process loads libraries and grows memory. What it finds is forgotten, so
  // that the first live solve starts like the first replayed one.
  CorrectionProblem first;
  first.learner = Pose(kJointCount);
  for (Eigen::Quaterniond& q : first.learner.q_PB) q = quaternion_from({0.3, -0.5, 0.4});
  (void)solve(first, {.deadline = 10.0, .iterations = kMostIterations});
  state_->warm = false;
  state_->asked.reset();
}

CorrectionSolver::~CorrectionSolver() = default;

CorrectionResult CorrectionSolver::solve(const CorrectionProblem& problem,
                                         const SolveLimit& limit) {
  const auto start = std::chrono::steady_clock::now();
  State& s = *state_;
  CorrectionResult result;
  result.frame = problem.frame;
  if (!s.model.pose(problem)) {
    result.status = SolverStatus::kFallback;
    result.solve_time = seconds_since(start);
    return result;
  }
  if (!s.model.has_error()) {  // nothing to solve; the last solution stays the next start
    result.status = SolverStatus::kConverged;
    result.solve_time = seconds_since(start);
    return result;
  }

  SplitProgramme& programme = *s.programme;
  const JointSet chosen = s.selection.select(s.most, s.asked, s.selected);
  if (!s.warm) programme.forget_balance();
  if (!s.warm || chosen != s.asked) programme.start_from(s.selected);
  s.asked = chosen;
  if (chosen.none()) {  // no joint is worth its price
    s.warm = false;
    result.status = SolverStatus::kConverged;
    result.solve_time = seconds_since(start);
    return result;
  }
  programme.begin(limit, start, s.selected);
  bool failed = false;
  {
    const std::lock_guard lock(mumps_mutex());
    try {
      const auto status = s.application->OptimizeTNLP(Ipopt::SmartPtr<Ipopt::TNLP>(&programme));
      failed = status != Ipopt::Solve_Succeeded && status != Ipopt::User_Requested_Stop &&
               status != Ipopt::Solved_To_Acceptable_Level;
    } catch (const std::exception&) {
      failed = true;
    }
  }
  // A solve that breaks off on its own breaks off again when replayed, if it is let: the count goes
  // one beyond, so that a limit never stops it earlier.
  result.iterations = static_cast<std::uint32_t>(programme.iteration() + (failed ? 1 : 0));

  s.model.closed_form(s.most, s.fallback);
  const bool usable = programme.feasible_seen() && !failed;
  if (usable) std::copy(programme.best().begin(), programme.best().end(), s.delta.begin());
  if (usable && programme.converged()) {
    result.status = SolverStatus::kConverged;
  } else if (usable && s.model.error(s.delta) <= s.model.error(s.fallback)) {
    result.status = SolverStatus::kDeadline;
  } else {
    s.delta = s.fallback;
    result.status = SolverStatus::kFallback;
  }
  s.report(result);

  s.warm = !failed && (programme.converged() || programme.iteration() < kStuck);
  if (s.warm) programme.keep_for_next();
  result.solve_time = seconds_since(start);
  return result;
}

}  // namespace secondskin::coach
