#include "coach/correct/joint_selection.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>

namespace secondskin::coach {
namespace {

// So many of the best sets by the quadratic model are looked at again with the true cost.
constexpr std::size_t kShortList = 8;
constexpr int kNewtonSteps = 2;
// Another choice has to lower the cost by this share more than the last choice does.
constexpr double kLoyalty = 0.05;
// The price of a centre of mass one centimetre beyond the support: one unit of error.
constexpr double kBalanceWeight = 1.0 / (0.01 * 0.01);
constexpr std::size_t kMostFreedoms = 3 * kJointCount;

// The movements of some joints and their places in delta.
struct Movements {
  std::array<std::size_t, kMostFreedoms> at;
  std::size_t count = 0;

  Movements(const CorrectionModel& model, const JointSet& joints) {
    for (std::size_t j = 0; j < kJointCount; ++j) {
      if (!joints[j]) continue;
      for (const int i : model.freedoms_of(j)) {
        if (i >= 0) at[count++] = static_cast<std::size_t>(i);
      }
    }
  }
};

// Minimises g.d + d.H.d / 2 over low <= d <= high by Newton steps: what a step would carry out of
// its bounds stays on them. @returns the minimum.
template <int kMost>
double box_minimum(const CorrectionModel& model, const Movements& movements,
                   std::span<const double> gradient, std::span<const double> hessian,
                   std::span<const double> from, std::span<double> step) {
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMost, kMost>;
  using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMost, 1>;
  const std::size_t n = model.size(), count = movements.count;
  std::array<bool, kMostFreedoms> held{};
  std::array<double, kMostFreedoms> d{};
  for (std::size_t round = 0; round <= count; ++round) {
    std::array<std::size_t, kMostFreedoms> free;
    std::size_t size = 0;
    for (std::size_t a = 0; a < count; ++a) {
      if (!held[a]) free[size++] = a;
    }
    if (size == 0) break;
    Matrix H(size, size);
    Vector g(size);
    for (std::size_t r = 0; r < size; ++r) {
      const std::size_t row = movements.at[free[r]];
      double slope = gradient[row];
      for (std::size_t a = 0; a < count; ++a) {
        if (held[a]) slope += hessian[row * n + movements.at[a]] * d[a];
      }
      g(static_cast<Eigen::Index>(r)) = -slope;
      for (std::size_t c = 0; c <= r; ++c) {
        H(static_cast<Eigen::Index>(r), static_cast<Eigen::Index>(c)) =
            hessian[row * n + movements.at[free[c]]];
      }
    }
    const Vector x = H.template selfadjointView<Eigen::Lower>().llt().solve(g);
    bool inside = true;
    for (std::size_t r = 0; r < size; ++r) {
      const std::size_t i = movements.at[free[r]];
      const double low = model.lower()[i] - from[i], high = model.upper()[i] - from[i];
      const double wanted = x(static_cast<Eigen::Index>(r));
      d[free[r]] = std::clamp(wanted, low, high);
      if (d[free[r]] != wanted) {
        held[free[r]] = true;
        inside = false;
      }
    }
    if (inside) break;
  }
  double value = 0.0;
  for (std::size_t a = 0; a < count; ++a) {
    const std::size_t i = movements.at[a];
    step[i] = d[a];
    double slope = gradient[i];
    for (std::size_t b = 0; b < count; ++b) slope += 0.5 * hessian[i * n + movements.at[b]] * d[b];
    value += slope * d[a];
  }
  return value;
}

double minimise(const CorrectionModel& model, const Movements& movements,
                std::span<const double> gradient, std::span<const double> hessian,
                std::span<const double> from, std::span<double> step) {
  return movements.count <= 6
             ? box_minimum<6>(model, movements, gradient, hessian, from, step)
             : box_minimum<kMostFreedoms>(model, movements, gradient, hessian, from, step);
}

}  // namespace

JointSelection::JointSelection(CorrectionModel& model) : model_(&model) {
  const std::size_t n = model.size();
  for (auto* v : {&gradient_, &gradient_here_, &amounts_, &trial_, &next_}) v->assign(n, 0.0);
  hessian_.assign(n * n, 0.0);
  hessian_here_.assign(n * n, 0.0);
  balance_.assign(model.constraints(), 0.0);
  jacobian_.assign(model.constraints() * n, 0.0);
}

// The gain that the quadratic model at no correction promises; the amounts go to trial_.
double JointSelection::quadratic(const JointSet& joints) {
  const Movements movements(*model_, joints);
  std::fill(trial_.begin(), trial_.end(), 0.0);
  return minimise(*model_, movements, gradient_, hessian_, amounts_, trial_);
}

double JointSelection::augmented(std::span<const double> delta) {
  double cost = model_->cost(delta);
  model_->balance(delta, balance_);
  for (std::size_t c = 0; c < balance_.size(); ++c) {
    const double beyond = std::max(0.0, balance_[c] - model_->balance_limit()[c]);
    cost += 0.5 * kBalanceWeight * beyond * beyond;
  }
  return cost;
}

void JointSelection::augmented_model(std::span<const double> delta) {
  const std::size_t n = model_->size();
  model_->gradient(delta, gradient_here_);
  model_->hessian(delta, hessian_here_);
  if (balance_.empty()) return;
  model_->balance(delta, balance_);
  model_->balance_jacobian(delta, jacobian_);
  for (std::size_t c = 0; c < balance_.size(); ++c) {
    const double beyond = balance_[c] - model_->balance_limit()[c];
    if (beyond <= 0.0) continue;
    const double* row = &jacobian_[c * n];
    for (std::size_t i = 0; i < n; ++i) {
      if (row[i] == 0.0) continue;
      gradient_here_[i] += kBalanceWeight * beyond * row[i];
      for (std::size_t j = 0; j < n; ++j) {
        hessian_here_[i * n + j] += kBalanceWeight * row[i] * row[j];
      }
    }
  }
}

void JointSelection::grow(const JointSet& open, std::size_t most, Candidate& set) {
  const std::size_t n = model_->size();
  while (set.joints.count() < most) {
    (void)quadratic(set.joints);
    // The slope that the set's amounts leave.
    for (std::size_t i = 0; i < n; ++i) {
      double slope = gradient_[i];
      for (std::size_t k = 0; k < n; ++k) slope += hessian_[i * n + k] * trial_[k];
      gradient_here_[i] = slope;
    }
    double least = 0.0;
    std::size_t best = kJointCount;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      if (!open[j] || set.joints[j]) continue;
      const double gain =
          model_->joint_price() + minimise(*model_, Movements(*model_, JointSet().set(j)),
                                           gradient_here_, hessian_, amounts_, next_);
      if (gain < least) {
        least = gain;
        best = j;
      }
    }
    if (best == kJointCount) return;
    set.joints.set(best);
  }
}

double JointSelection::amounts(const JointSet& joints, int steps, std::span<double> delta) {
  const JointSet open = model_->open();
  std::fill(amounts_.begin(), amounts_.end(), 0.0);
  model_->gradient(amounts_, gradient_);
  model_->hessian(amounts_, hessian_);
  (void)quadratic(joints & open);
  const double cost = refine(joints & open, steps);
  std::copy(trial_.begin(), trial_.end(), delta.begin());
  model_->restrict_to(open);
  return cost;
}

// From trial_, Newton steps on the true cost with only these joints open; the amounts go to trial_.
double JointSelection::refine(const JointSet& joints, int steps) {
  model_->restrict_to(joints);
  const Movements movements(*model_, joints);
  std::vector<double>& here = amounts_;
  std::vector<double>& next = next_;
  here = trial_;
  double cost = augmented(here);
  for (int step = 0; step < steps; ++step) {
    augmented_model(here);
    std::fill(trial_.begin(), trial_.end(), 0.0);
    (void)minimise(*model_, movements, gradient_here_, hessian_here_, here, trial_);
    bool better = false;
    for (double part = 1.0; part > 0.2 && !better; part *= 0.5) {
      for (std::size_t i = 0; i < next.size(); ++i) {
        next[i] = std::clamp(here[i] + part * trial_[i], model_->lower()[i], model_->upper()[i]);
      }
      const double then = augmented(next);
      if (!(then < cost)) continue;
      better = true;
      cost = then;
      std::swap(here, next);
    }
    if (!better) break;
  }
  trial_ = here;
  return cost;
}

JointSet JointSelection::select(std::size_t most, const JointSet& previous,
                                std::span<double> delta) {
  CorrectionModel& model = *model_;
  const JointSet open = model.open();
  std::fill(delta.begin(), delta.end(), 0.0);
  if (most == 0 || open.none()) {
    model.restrict_to({});
    return {};
  }
  std::fill(amounts_.begin(), amounts_.end(), 0.0);
  const double none = model.cost(amounts_);
  model.gradient(amounts_, gradient_);
  model.hessian(amounts_, hessian_);
  const double price = model.joint_price();

  candidates_.clear();
  for (std::size_t a = 0; a < kJointCount; ++a) {
    if (!open[a]) continue;
    JointSet set;
    set.set(a);
    candidates_.push_back({set, quadratic(set) + price});
    for (std::size_t b = a + 1; b < kJointCount && most >= 2; ++b) {
      if (!open[b]) continue;
      JointSet pair = set;
      pair.set(b);
      candidates_.push_back({pair, quadratic(pair) + 2.0 * price});
    }
  }
  const std::size_t listed = std::min(kShortList, candidates_.size());
  std::partial_sort(candidates_.begin(), candidates_.begin() + static_cast<std::ptrdiff_t>(listed),
                    candidates_.end(),
                    [](const Candidate& a, const Candidate& b) { return a.value < b.value; });
  candidates_.resize(listed);
  // More than two: to the best pair the one that helps most beside those already there, and again.
  if (most > 2) {
    candidates_.resize(1);
    grow(open, most, candidates_.front());
  }
  const JointSet last = previous & open;
  if (last.any() && last.count() <= most) {
    candidates_.push_back({last, 0.0});
  }

  JointSet chosen;
  double least = 0.0;
  for (const Candidate& candidate : candidates_) {
    model.restrict_to(open);
    std::fill(amounts_.begin(), amounts_.end(), 0.0);
    (void)quadratic(candidate.joints);
    const double value = refine(candidate.joints, kNewtonSteps) - none +
                         static_cast<double>(candidate.joints.count()) * price;
    const bool is_last = candidate.joints == last;
    if (value < least || (is_last && value < (1.0 - kLoyalty) * least)) {
      least = std::min(value, least);
      chosen = candidate.joints;
      std::copy(trial_.begin(), trial_.end(), delta.begin());
    }
  }
  model.restrict_to(chosen);
  return chosen;
}

}  // namespace secondskin::coach
