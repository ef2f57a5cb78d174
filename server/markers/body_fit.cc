#include "server/markers/body_fit.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "motion/rotation.h"

namespace secondskin::server {
namespace {

using Vector3 = Eigen::Vector3d;

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kKernel = 5.0;  // [sigma]

// A joint that nobody sees goes on for about this long [s].
constexpr double kPersistence = 0.15;
// Speeds met in practice are a third of the fastest voluntary ones, 1 sigma.
constexpr double kUsualSpeed = 1.0 / 3.0;
constexpr double kSlowest = 2.0;    // [rad/s] for joints that hardly move
constexpr double kRootSpeed = 1.0;  // [m/s]
// Nothing is less known than this: the whole range of a joint, the reach of a room.
constexpr double kWidestAngle = 1.0;  // [rad]
constexpr double kWidestPlace = 1.0;  // [m]
constexpr double kConfident = 8.0 * kDegree;

std::vector<Site> sites(const MarkerBody& body) {
  std::vector<Site> result;
  for (const Attachment& a : body.attachments) result.push_back({a.segment, a.p_BM, a.sigma});
  return result;
}

}  // namespace

BodyFit::BodyFit(const MarkerBody& body)
    : body_(body),
      solver_(body.skeleton, sites(body)),
      p_WM_(body.attachments.size(), Vector3::Zero()),
      sigma_(body.attachments.size(), 0.0),
      room_(body.attachments.size(), 0.0) {
  const int n = solver_.dofs();
  for (PoseSolver::Vector* v : {&velocity_, &p_, &pv_, &v_, &drive_, &information_}) v->setZero(n);
  // In the stationary state of v' = -v / tau + a the velocity's variance is density * tau / 2.
  const auto density = [](double speed) { return 2.0 * speed * speed / kPersistence; };
  drive_.head<3>().setConstant(density(kRootSpeed));
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const auto c = solver_.column(static_cast<Joint>(i));
    if (!c) continue;
    const auto& speed = canonical_anatomy()[i].max_speed;
    const double usual = kUsualSpeed * *std::max_element(speed.begin(), speed.end());
    drive_.segment<3>(*c).setConstant(density(std::max(kSlowest, usual)));
  }
}

void BodyFit::predict(double dt) noexcept {
  const double keep = std::exp(-dt / kPersistence);
  const double reach = kPersistence * (1.0 - keep);
  PoseSolver::Vector dx = reach * velocity_;
  PlacedPose predicted;
  solver_.step(pose_, dx, predicted);
  pose_ = predicted;
  velocity_ *= keep;
  const Eigen::Index n = solver_.dofs();
  for (Eigen::Index i = 0; i < n; ++i) {
    const double s = drive_[i];
    const double widest = i < 3 ? kWidestPlace : kWidestAngle;
    const double p = p_[i] + 2.0 * reach * pv_[i] + reach * reach * v_[i] + s * dt * dt * dt / 3.0;
    const double pv = keep * (pv_[i] + reach * v_[i]) + 0.5 * s * dt * dt;
    const double v = keep * keep * v_[i] + s * dt;
    // Where the bound bites, position is no longer tied to velocity.
    const double bound = widest * widest;
    p_[i] = std::clamp(p, 1e-10, bound);
    v_[i] = v;
    pv_[i] = p > bound ? 0.0 : pv;
    information_[i] = 1.0 / p_[i];
  }
}

// The solved pose as a measurement of each coordinate by itself: from the variance before and
// after follows the gain of the velocity.
void BodyFit::absorb(const PoseSolver::Vector& variance) noexcept {
  for (Eigen::Index i = 0; i < solver_.dofs(); ++i) {
    const double before = p_[i], after = std::min(variance[i], before);
    const double gain = pv_[i] / before;
    v_[i] = std::max(1e-8, v_[i] - gain * pv_[i] * (1.0 - after / before));
    pv_[i] *= after / before;
    p_[i] = after;
  }
}

bool BodyFit::marginals(PoseSolver::Matrix& H, PoseSolver::Vector& variance) const noexcept {
  const Eigen::Index n = solver_.dofs();
  const Eigen::LLT<Eigen::Ref<PoseSolver::Matrix>> llt(H);
  if (llt.info() != Eigen::Success) return false;
  PoseSolver::Matrix inverse = PoseSolver::Matrix::Identity(n, n);
  llt.matrixL().solveInPlace(inverse);  // H^-1 = L^-T L^-1
  variance = inverse.colwise().squaredNorm().transpose();
  return variance.allFinite();
}

std::size_t BodyFit::in_place(const PlacedPose& pose) const noexcept {
  std::size_t count = 0;
  for (std::size_t m = 0; m < sigma_.size(); ++m) {
    if (!(sigma_[m] > 0.0)) continue;
    const Attachment& a = body_.attachments[m];
    const Vector3 r = p_WM_[m] - pose.X_WB[index(a.segment)] * a.p_BM;
    if (r.squaredNorm() < kGate * kGate * sigma_[m] * sigma_[m]) ++count;
  }
  return count;
}

bool BodyFit::restart() noexcept {
  PoseSolver::Observation seen{p_WM_, room_, 20.0, nullptr, nullptr};
  PlacedPose best;
  std::size_t most = 0;
  PoseSolver::Matrix H;
  std::size_t visible = 0;
  for (const double s : sigma_) visible += s > 0.0 ? 1 : 0;
  // From the last pose where there is one, and from the markers alone.
  for (std::size_t attempt = 0; attempt <= PoseSolver::kRoots.size(); ++attempt) {
    PlacedPose pose = pose_;
    seen.sigma = room_;
    if (attempt == 0 && !started_) continue;
    if (attempt > 0) {
      pose = PlacedPose();
      if (!solver_.initialise(seen, PoseSolver::kRoots[attempt - 1], pose)) continue;
    }
    for (std::size_t m = 0; m < sigma_.size(); ++m) room_[m] = 3.0 * sigma_[m];
    seen.kernel = 20.0;
    solver_.solve(seen, 12, pose, H);
    seen.kernel = kKernel;
    solver_.solve(seen, 12, pose, H);
    seen.sigma = sigma_;
    solver_.solve(seen, 12, pose, H);
    const std::size_t count = in_place(pose);
    if (count <= most) continue;
    most = count;
    best = pose;
    if (10 * most >= 9 * visible) break;
  }
  constexpr double kAgreeing = 0.6;
  if (most < MarkerSet::kLeastMarkers ||
      static_cast<double>(most) < kAgreeing * static_cast<double>(visible)) {
    return false;
  }
  pose_ = best;
  solver_.evaluate(pose_, {p_WM_, sigma_, kKernel, nullptr, nullptr}, &H, &information_);
  velocity_.setZero();
  pv_.setZero();
  v_ = 0.5 * kPersistence * drive_;
  PoseSolver::Vector variance;
  p_.setConstant(kWidestAngle * kWidestAngle);
  if (marginals(H, variance)) p_ = p_.cwiseMin(variance);
  return true;
}

BodyFit::Result BodyFit::update(const MarkerFrame& frame, double dt, Pose& out) noexcept {
  Result result;
  for (std::size_t m = 0; m < sigma_.size(); ++m) {
    const Attachment& a = body_.attachments[m];
    const bool seen = a.marker < frame.p_WM.size() && a.marker < frame.visible.size() &&
                      frame.visible[a.marker] != 0 && frame.p_WM[a.marker].allFinite() &&
                      frame.p_WM[a.marker].norm() < 1e3;
    const double own = seen && a.marker < frame.residual.size() && frame.residual[a.marker] > 0.0F
                           ? static_cast<double>(frame.residual[a.marker])
                           : 0.0;
    sigma_[m] = seen ? std::max(a.sigma, std::isfinite(own) ? own : 0.0) : 0.0;
    room_[m] = sigma_[m];
    if (!seen) continue;
    p_WM_[m] = frame.p_WM[a.marker];
    ++result.visible;
  }
  if (started_) {
    constexpr double kLongest = 10.0;
    predict(std::isfinite(dt) ? std::clamp(dt, 0.0, kLongest) : 0.0);
    // Room for the prediction's own error, coordinate by coordinate: sigma^2 + tr(J P J^T) / 3.
    double widest = 1.0;
    for (std::size_t m = 0; m < sigma_.size(); ++m) {
      if (!(sigma_[m] > 0.0)) continue;
      const Attachment& a = body_.attachments[m];
      double spread = p_.head<3>().sum();
      const Vector3 p_WM = pose_.X_WB[index(a.segment)] * a.p_BM;
      for (std::size_t j = index(a.segment);; j = *solver_.skeleton()[j].parent) {
        if (const auto c = solver_.column(static_cast<Joint>(j))) {
          const auto& X = pose_.X_WB[j];
          const Vector3 arm = X.linear().transpose() * (p_WM - X.translation());
          // |e_k x arm|^2 = |arm|^2 - arm_k^2
          for (int k = 0; k < 3; ++k) {
            spread += p_[*c + k] * (arm.squaredNorm() - arm[k] * arm[k]);
          }
        }
        if (j == 0) break;
      }
      room_[m] = std::sqrt(sigma_[m] * sigma_[m] + spread / 3.0);
      widest = std::max(widest, room_[m] / sigma_[m]);
    }
    const PlacedPose predicted = pose_;
    PoseSolver::Observation seen{p_WM_, room_, kKernel, &predicted, &information_};
    PoseSolver::Matrix H;
    constexpr double kClose = 1.5;
    constexpr int kIterations = 8;
    if (widest > kClose) solver_.solve(seen, kIterations, pose_, H);
    seen.sigma = sigma_;
    solver_.solve(seen, kIterations, pose_, H);
    result.used = in_place(pose_);
    // Half of the markers elsewhere: it is the pose that is wrong.
    const bool agree = 2 * result.used >= result.visible;
    disagreeing_ = agree ? 0 : disagreeing_ + 1;
    if (!agree && restart()) {
      result.restarted = true;
      result.used = in_place(pose_);
      disagreeing_ = 0;
    } else if (!agree) {
      pose_ = predicted;
      result.used = 0;
    } else {
      PoseSolver::Vector variance;
      if (marginals(H, variance)) {
        // The change of each coordinate against the prediction drives its velocity.
        velocity_.head<3>() +=
            (pv_.head<3>().array() / p_.head<3>().array() * (pose_.p_WR - predicted.p_WR).array())
                .matrix();
        for (std::size_t i = 0; i < kJointCount; ++i) {
          const auto c = solver_.column(static_cast<Joint>(i));
          if (!c) continue;
          const Vector3 change = rotation_vector(predicted.q_PB[i].conjugate() * pose_.q_PB[i]);
          velocity_.segment<3>(*c) +=
              (pv_.segment<3>(*c).array() / p_.segment<3>(*c).array() * change.array()).matrix();
        }
        absorb(variance);
      }
    }
    result.tracked = result.visible > 0 && (agree || result.restarted);
  } else if (restart()) {
    started_ = true;
    disagreeing_ = 0;
    result.restarted = result.tracked = true;
    result.used = in_place(pose_);
  }

  double squares = 0.0;
  std::size_t count = 0;
  for (std::size_t m = 0; m < sigma_.size() && result.used > 0; ++m) {
    if (!(sigma_[m] > 0.0)) continue;
    const Attachment& a = body_.attachments[m];
    const double d2 = (p_WM_[m] - pose_.X_WB[index(a.segment)] * a.p_BM).squaredNorm();
    if (!(d2 < kGate * kGate * sigma_[m] * sigma_[m])) continue;
    squares += d2;
    ++count;
  }
  if (count > 0) result.residual = std::sqrt(squares / static_cast<double>(count));

  out.q_PB.resize(kJointCount, Eigen::Quaterniond::Identity());
  out.confidence.resize(kJointCount, 0.0F);
  out.p_WR = pose_.p_WR;
  for (std::size_t i = 0; i < kJointCount; ++i) {
    out.q_PB[i] = pose_.q_PB[i];
    const double s = sigma(static_cast<Joint>(i)) / kConfident;
    out.confidence[i] = static_cast<float>(1.0 / (1.0 + s * s));
  }
  return result;
}

double BodyFit::sigma(Joint joint) const noexcept {
  const auto c = solver_.column(joint);
  if (!c || !started_) return std::numeric_limits<double>::infinity();
  return std::sqrt(p_.segment<3>(*c).maxCoeff());
}

}  // namespace secondskin::server
