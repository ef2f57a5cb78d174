#include "server/markers/marker_body.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>

#include "motion/kinematics.h"
#include "motion/rotation.h"
#include "server/markers/pose_solver.h"

namespace secondskin::server {
namespace {

using Vector3 = Eigen::Vector3d;
using Matrix3 = Eigen::Matrix3d;
using Eigen::Isometry3d;
using Eigen::Quaterniond;

constexpr double kDegree = std::numbers::pi / 180.0;

double median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

bool shows(const MarkerFrame& frame, std::size_t marker) {
  return frame.visible[marker] != 0 && frame.p_WM[marker].allFinite();
}

// ---------------------------------------------------------------------------------------------
// What anatomy expects of this wearer before the adjustment: a body and the markers' places on it.

struct Expected {
  std::vector<Attachment> sites;
  std::vector<Vector3> spread;  // of each site's place, 1 sigma [m]
  std::vector<Landmark> landmark;
  std::array<Vector3, kJointCount> p_PB;
  std::array<Vector3, kJointCount> p_PB_spread;  // 0: taken as it is
  Skeleton nominal;
  double scale = 1.0;

  Skeleton skeleton(const std::array<Vector3, kJointCount>& offsets) const;
  Skeleton skeleton() const { return skeleton(p_PB); }
};

// The nominal body with other offsets; ends and centres of mass go in proportion.
Skeleton Expected::skeleton(const std::array<Vector3, kJointCount>& offsets) const {
  std::vector<Segment> segments = nominal.segments();
  for (std::size_t i = 0; i < kJointCount; ++i) segments[i].p_PB = offsets[i];
  for (std::size_t i = 0; i < kJointCount; ++i) {
    double ratio = scale;
    for (std::size_t k = i + 1; k < kJointCount; ++k) {
      if (*segments[k].parent != i || i == 0 || i == index(Joint::kSpineUpper)) continue;
      ratio = offsets[k].norm() / nominal[k].p_PB.norm();
    }
    segments[i].p_BE *= ratio;
    segments[i].p_BC *= ratio;
  }
  return Skeleton(std::move(segments));
}

// A limb's own length moves what sits along it: the child's joint below each long bone.
std::optional<Joint> far_joint(Joint segment) {
  switch (segment) {
    case Joint::kLeftShoulder:
    case Joint::kRightShoulder:
    case Joint::kLeftElbow:
    case Joint::kRightElbow:
    case Joint::kLeftHip:
    case Joint::kRightHip:
    case Joint::kLeftKnee:
    case Joint::kRightKnee:
      return static_cast<Joint>(index(segment) + 1);
    default:
      return std::nullopt;
  }
}

// How much larger the wearer is than the nominal body: the median ratio of distances between
// markers of one segment.
double find_scale(const std::vector<Attachment>& sites, const MarkerMotion& trial) {
  constexpr double kLongEnough = 0.08;
  constexpr std::size_t kFrames = 200;
  const std::size_t step = std::max<std::size_t>(1, trial.frames.size() / kFrames);
  std::vector<double> ratios;
  for (std::size_t a = 0; a < sites.size(); ++a) {
    for (std::size_t b = 0; b < a; ++b) {
      const double nominal = (sites[a].p_BM - sites[b].p_BM).norm();
      if (sites[a].segment != sites[b].segment || nominal < kLongEnough) continue;
      std::vector<double> distances;
      for (std::size_t f = 0; f < trial.frames.size(); f += step) {
        const MarkerFrame& frame = trial.frames[f];
        if (!shows(frame, sites[a].marker) || !shows(frame, sites[b].marker)) continue;
        distances.push_back((frame.p_WM[sites[a].marker] - frame.p_WM[sites[b].marker]).norm());
      }
      if (!distances.empty()) ratios.push_back(median(distances) / nominal);
    }
  }
  const double scale = ratios.empty() ? 1.0 : median(ratios);
  constexpr double kSmallest = 0.4, kLargest = 1.5;
  if (!(scale >= kSmallest && scale <= kLargest)) {
    throw std::runtime_error(fmt::format(
        "the markers of one segment lie {:.3g} times as far apart as on the set's body of 1.75 m; "
        "expected {} to {}: is the file's unit right?",
        scale, kSmallest, kLargest));
  }
  return scale;
}

// Where the iliac spines lie in the pelvis, from their mean shape, and the hip centres after
// Harrington et al. 2007 (J. Biomech. 40:595, table 4, by pelvic width and depth). The plane
// through the spines leans forward in upright standing; by how much here is adults' mean, and
// calibration replaces it by the wearer's own where the trial shows standing.
void expect_pelvis(const MarkerMotion& trial, Expected& expected) {
  constexpr double kLean = 10.0 * kDegree;
  constexpr double kMarkerRadius = 0.007;
  std::optional<std::size_t> la, ra, lp, rp, sacrum;
  for (std::size_t i = 0; i < expected.sites.size(); ++i) {
    switch (expected.landmark[i]) {
      case Landmark::kLeftAnteriorIliacSpine:
        la = i;
        break;
      case Landmark::kRightAnteriorIliacSpine:
        ra = i;
        break;
      case Landmark::kLeftPosteriorIliacSpine:
        lp = i;
        break;
      case Landmark::kRightPosteriorIliacSpine:
        rp = i;
        break;
      case Landmark::kSacrum:
        sacrum = i;
        break;
      case Landmark::kNone:
        break;
    }
  }
  if (!la || !ra || !((lp && rp) || sacrum)) return;
  const auto& sites = expected.sites;
  std::vector<double> width, depth;
  std::array<std::vector<double>, 3> back_left, back_right, back_middle;  // in the spines' frame
  for (const MarkerFrame& frame : trial.frames) {
    const auto at = [&](std::size_t i) { return frame.p_WM[sites[i].marker]; };
    const auto seen = [&](const std::optional<std::size_t>& i) {
      return i && shows(frame, sites[*i].marker);
    };
    if (!seen(la) || !seen(ra)) continue;
    const bool pair = seen(lp) && seen(rp);
    if (!pair && !seen(sacrum)) continue;
    const Vector3 front = 0.5 * (at(*la) + at(*ra));
    const Vector3 back = pair ? Vector3(0.5 * (at(*lp) + at(*rp))) : at(*sacrum);
    Vector3 y = (at(*la) - at(*ra)).normalized();
    const Vector3 forward = front - back;
    const Vector3 x = (forward - forward.dot(y) * y).normalized();
    // The trunk is above the pelvis; if not, left and right are exchanged, which will be noticed.
    Vector3 above = Vector3::Zero();
    for (const Attachment& site : sites) {
      const bool upper = site.segment >= Joint::kSpineMiddle && site.segment <= Joint::kHead;
      if (upper && shows(frame, site.marker)) above += frame.p_WM[site.marker] - front;
    }
    if (x.cross(y).dot(above) < 0.0) y = -y;
    Matrix3 R;
    R << x, y, x.cross(y);
    if (!R.allFinite()) continue;
    width.push_back((at(*la) - at(*ra)).norm());
    depth.push_back(forward.dot(x));
    const auto add = [&](const std::optional<std::size_t>& i, auto& lists) {
      if (!seen(i)) return;
      const Vector3 p = R.transpose() * (at(*i) - front);
      for (std::size_t k = 0; k < 3; ++k) lists[k].push_back(p[static_cast<Eigen::Index>(k)]);
    };
    add(lp, back_left);
    add(rp, back_right);
    add(sacrum, back_middle);
  }
  if (width.empty()) return;
  const double pw = median(width), pd = median(depth) - 2.0 * kMarkerRadius;
  if (!(pw > 0.1 && pw < 0.5 && pd > 0.05 && pd < 0.4)) return;  // no pelvis; the nominal one stays
  const Vector3 hips(-0.24 * pd - 0.0099 - kMarkerRadius, 0.0, -0.30 * pw - 0.0109);
  const double half = 0.33 * pw + 0.0073;
  const Matrix3 lean = Eigen::AngleAxisd(kLean, Vector3::UnitY()).toRotationMatrix();
  const auto set = [&](const std::optional<std::size_t>& i, const Vector3& p) {
    if (!i) return;
    expected.sites[*i].p_BM = lean * (p - hips);
    expected.spread[*i].setConstant(0.005);  // only what the mean shape leaves
  };
  const auto middle = [](const std::array<std::vector<double>, 3>& lists) {
    return Vector3(median(lists[0]), median(lists[1]), median(lists[2]));
  };
  set(la, {0.0, 0.5 * pw, 0.0});
  set(ra, {0.0, -0.5 * pw, 0.0});
  if (!back_left[0].empty()) set(lp, middle(back_left));
  if (!back_right[0].empty()) set(rp, middle(back_right));
  if (!back_middle[0].empty()) set(sacrum, middle(back_middle));
  for (const Joint hip : {Joint::kLeftHip, Joint::kRightHip}) {
    expected.p_PB[index(hip)] = {0.0, hip == Joint::kLeftHip ? half : -half, 0.0};
    expected.p_PB_spread[index(hip)].setConstant(0.008);
  }
}

Expected expect(const MarkerSet& set, const MarkerMotion& trial) {
  Expected expected{{}, {}, {}, {}, {}, set.nominal(), 1.0};
  const auto match = set.match(trial.names);
  constexpr double kSeenEnough = 0.05;
  for (std::size_t i = 0; i < match.size(); ++i) {
    if (!match[i]) continue;
    std::size_t seen = 0;
    for (const MarkerFrame& frame : trial.frames) seen += shows(frame, *match[i]) ? 1 : 0;
    if (static_cast<double>(seen) < kSeenEnough * static_cast<double>(trial.frames.size())) {
      continue;
    }
    const MarkerPlace& place = set.places()[i];
    expected.sites.push_back(
        {*match[i], trial.names[*match[i]], place.segment, place.p_BM, place.sway});
    expected.spread.push_back(place.spread);
    expected.landmark.push_back(place.landmark);
  }
  if (expected.sites.size() < MarkerSet::kLeastMarkers) {
    throw std::runtime_error(fmt::format(
        "{} of the markers of set \"{}\" are in the trial, expected at least {}; the trial has {}",
        expected.sites.size(), set.name(), MarkerSet::kLeastMarkers, fmt::join(trial.names, ", ")));
  }
  const double scale = expected.scale = find_scale(expected.sites, trial);
  for (Attachment& site : expected.sites) site.p_BM *= scale;
  // What the lengths of an average body of this size leave open. A limb's joint lies on its long
  // axis, which is what the frame's z is; the trunk's and the clavicle's own joints stay in
  // proportion where no marker lies between.
  constexpr double kLimb = 0.08;  // of a limb's length, 1 sigma
  for (std::size_t i = 0; i < kJointCount; ++i) {
    expected.p_PB[i] = scale * set.nominal()[i].p_PB;
    expected.p_PB_spread[i].setZero();
    const auto joint = static_cast<Joint>(i);
    Vector3& spread = expected.p_PB_spread[i];
    switch (joint) {
      case Joint::kLeftElbow:
      case Joint::kRightElbow:
      case Joint::kLeftWrist:
      case Joint::kRightWrist:
      case Joint::kLeftKnee:
      case Joint::kRightKnee:
      case Joint::kLeftAnkle:
      case Joint::kRightAnkle:
        spread.z() = kLimb * expected.p_PB[i].norm();
        break;
      case Joint::kSpineLower:
        spread = {0.02, 0.004, 0.03};
        break;
      case Joint::kNeck:
        spread = {0.015, 0.004, 0.02};
        break;
      case Joint::kLeftShoulder:
      case Joint::kRightShoulder:
        spread = {0.012, 0.015, 0.012};
        break;
      case Joint::kLeftHip:
      case Joint::kRightHip:
        spread = {0.02, 0.015, 0.02};
        break;
      default:
        break;
    }
  }
  expect_pelvis(trial, expected);
  return expected;
}

// ---------------------------------------------------------------------------------------------
// Bundle adjustment.

struct Shot {
  std::vector<Vector3> p_WM;  // by site
  std::vector<double> sigma;  // 0: not seen
  PlacedPose pose;
};

class Adjustment {
 public:
  Adjustment(const Expected& expected)
      : expected_(expected),
        p_PB_(expected.p_PB),
        solver_(expected.skeleton(), solver_sites(expected.sites)) {
    for (const Attachment& site : expected.sites) p_BM_.push_back(site.p_BM);
    prior_ = p_BM_;
    int n = 3 * static_cast<int>(p_BM_.size());
    for (std::size_t j = 0; j < kJointCount; ++j) {
      for (std::size_t a = 0; a < 3; ++a) {
        const bool open = expected.p_PB_spread[j][static_cast<Eigen::Index>(a)] > 0.0 &&
                          solver_.column(static_cast<Joint>(j)).has_value();
        offset_[j][a] = open ? n++ : -1;
      }
    }
    shared_ = n;
  }

  static std::vector<Site> solver_sites(const std::vector<Attachment>& sites) {
    std::vector<Site> result;
    for (const Attachment& site : sites) result.push_back({site.segment, site.p_BM, site.sigma});
    return result;
  }

  const PoseSolver& solver() const { return solver_; }
  const std::vector<Vector3>& places() const { return p_BM_; }
  /// Where the set would have a marker on a wearer of these lengths.
  Vector3 expected_place(std::size_t m) const {
    Vector3 p = prior_[m];
    if (const auto far = far_joint(expected_.sites[m].segment)) {
      p.z() *= p_PB_[index(*far)].z() / expected_.p_PB[index(*far)].z();
    }
    return p;
  }

  Shot shot(const MarkerFrame& frame) const {
    Shot shot;
    for (const Attachment& site : expected_.sites) {
      const bool seen = shows(frame, site.marker);
      shot.p_WM.push_back(seen ? frame.p_WM[site.marker] : Vector3::Zero());
      shot.sigma.push_back(seen ? site.sigma : 0.0);
    }
    return shot;
  }

  // A pose for one frame from nothing: first with room for a body that is not yet the wearer's.
  // Returns the share of its markers that lie where they should.
  double pose_alone(Shot& shot, double roominess) const {
    std::vector<double> sigma = shot.sigma;
    for (double& s : sigma) s *= roominess;
    PoseSolver::Matrix H;
    PoseSolver::Observation seen{shot.p_WM, sigma, 4.0, nullptr, nullptr};
    constexpr int kIterations = 30;
    constexpr double kNearlyAll = 0.85;
    double best = 0.0;
    for (const PoseSolver::Root root : PoseSolver::kRoots) {
      Shot trial = shot;
      trial.pose = PlacedPose();
      if (!solver_.initialise(seen, root, trial.pose)) continue;
      seen.kernel = 20.0;
      solver_.solve(seen, kIterations, trial.pose, H);
      seen.kernel = 4.0;
      solver_.solve(seen, kIterations, trial.pose, H);
      const double share = share_in_place(trial, sigma);
      if (share > best) shot.pose = trial.pose;
      best = std::max(best, share);
      if (best > kNearlyAll) break;
    }
    return best;
  }

  double share_in_place(const Shot& shot, const std::vector<double>& sigma) const {
    double in_place = 0.0, seen = 0.0;
    for (std::size_t m = 0; m < p_BM_.size(); ++m) {
      if (!(sigma[m] > 0.0)) continue;
      seen += 1.0;
      if (residual(shot, m).norm() < 4.0 * sigma[m]) in_place += 1.0;
    }
    return seen > 0.0 ? in_place / seen : 0.0;
  }

  Vector3 residual(const Shot& shot, std::size_t m) const {
    return shot.p_WM[m] - shot.pose.X_WB[index(expected_.sites[m].segment)] * p_BM_[m];
  }

  // Lengths, places and all poses together: Levenberg-Marquardt, poses eliminated frame by frame
  // (Schur complement). Neighbouring frames share their skin's displacement, so all frames together
  // count for no more than kIndependent against the priors.
  // Returns the cost of one frame.
  double adjust(std::vector<Shot>& shots, double kernel, int most_iterations) {
    constexpr double kIndependent = 10.0;
    const double weight = std::max(1.0, static_cast<double>(shots.size()) / kIndependent);
    double lambda = 1e-6;
    Eigen::MatrixXd S(shared_, shared_), A;
    Eigen::VectorXd b(shared_), ds;
    double cost = total_cost(shots, kernel, weight);
    for (int iteration = 0; iteration < most_iterations; ++iteration) {
      S.setZero();
      b.setZero();
      add_prior(weight, &S, &b);
      S.diagonal() *= 1.0 + lambda;
      const Eigen::Index n = solver_.dofs();
      std::vector<Eigen::MatrixXd> back(shots.size());  // H_pp^-1 [H_ps, g_p]
      for (std::size_t f = 0; f < shots.size(); ++f) {
        PoseSolver::Matrix H;
        PoseSolver::Vector g;
        const PoseSolver::Observation seen{shots[f].p_WM, shots[f].sigma, kernel, nullptr, nullptr};
        solver_.evaluate(shots[f].pose, seen, &H, &g);
        H.diagonal() *= 1.0 + lambda;
        Eigen::MatrixXd right = Eigen::MatrixXd::Zero(n, shared_ + 1);
        right.col(shared_) = g;
        add_shared(shots[f], kernel, right, S, b, lambda);
        const Eigen::LLT<Eigen::MatrixXd> llt(H);
        back[f] = llt.solve(right);
        S.noalias() -= right.leftCols(shared_).transpose() * back[f].leftCols(shared_);
        b.noalias() -= right.leftCols(shared_).transpose() * back[f].col(shared_);
      }
      ds = S.ldlt().solve(b);
      if (!ds.allFinite()) break;
      // The step.
      const std::vector<Vector3> old_places = p_BM_;
      const auto old_offsets = p_PB_;
      std::vector<PlacedPose> old_poses;
      for (std::size_t m = 0; m < p_BM_.size(); ++m) {
        p_BM_[m] += ds.segment<3>(3 * static_cast<Eigen::Index>(m));
      }
      for (std::size_t j = 0; j < kJointCount; ++j) {
        for (std::size_t a = 0; a < 3; ++a) {
          if (offset_[j][a] >= 0) p_PB_[j][static_cast<Eigen::Index>(a)] += ds[offset_[j][a]];
        }
      }
      reshape();
      double longest = ds.cwiseAbs().maxCoeff();
      for (std::size_t f = 0; f < shots.size(); ++f) {
        old_poses.push_back(shots[f].pose);
        PoseSolver::Vector dx = back[f].col(shared_) - back[f].leftCols(shared_) * ds;
        longest = std::max(longest, dx.cwiseAbs().maxCoeff());
        constexpr double kLongestStep = 0.5;
        const double most = dx.cwiseAbs().maxCoeff();
        if (most > kLongestStep) dx *= kLongestStep / most;
        solver_.step(old_poses[f], dx, shots[f].pose);
      }
      const double trial = total_cost(shots, kernel, weight);
      constexpr double kSmallStep = 1e-5;
      if (trial <= cost) {
        const bool done = longest < kSmallStep || cost - trial < 1e-6 * cost;
        cost = trial;
        lambda = std::max(1e-9, 0.1 * lambda);
        if (done) break;
      } else {
        p_BM_ = old_places;
        p_PB_ = old_offsets;
        reshape();
        for (std::size_t f = 0; f < shots.size(); ++f) shots[f].pose = old_poses[f];
        lambda = std::max(1e-4, 10.0 * lambda);
        if (lambda > 1e6) break;
      }
    }
    return cost / static_cast<double>(shots.size());
  }

  // Turns the frame of a segment, and of what moves with it rigidly, by q_BB': the same body.
  void turn_frame(Joint segment, const Quaterniond& turn) {
    const Quaterniond back = turn.conjugate();
    std::array<bool, kJointCount> rigid{};
    for (std::size_t i = index(segment); i < kJointCount; ++i) {
      rigid[i] = i == index(segment) || (i > 0 && rigid[*expected_.nominal[i].parent] &&
                                         !solver_.column(static_cast<Joint>(i)).has_value());
      if (i > index(segment) && i > 0 && rigid[*expected_.nominal[i].parent]) {
        p_PB_[i] = back * p_PB_[i];
      }
    }
    for (std::size_t m = 0; m < p_BM_.size(); ++m) {
      if (!rigid[index(expected_.sites[m].segment)]) continue;
      p_BM_[m] = back * p_BM_[m];
      prior_[m] = back * prior_[m];
    }
    reshape();
  }

 private:
  void reshape() {
    std::vector<Site> sites = solver_sites(expected_.sites);
    for (std::size_t m = 0; m < sites.size(); ++m) sites[m].p_BM = p_BM_[m];
    solver_.reshape(expected_.skeleton(p_PB_), std::move(sites));
  }

  double total_cost(std::vector<Shot>& shots, double kernel, double weight) {
    double cost = add_prior(weight, nullptr, nullptr);
    for (Shot& shot : shots) {
      solver_.place(shot.pose);
      cost += solver_.evaluate(shot.pose, {shot.p_WM, shot.sigma, kernel, nullptr, nullptr},
                               nullptr, nullptr);
    }
    return cost;
  }

  // Where a place is expected: what sits along a limb goes with the limb's length.
  double add_prior(double weight, Eigen::MatrixXd* S, Eigen::VectorXd* b) const {
    double cost = 0.0;
    // One residual, linear in at most two unknowns.
    const auto add = [&](double error, double sigma, int i, double di, int k, double dk) {
      const double w = weight / (sigma * sigma);
      cost += w * error * error;
      if (S == nullptr) return;
      (*S)(i, i) += w * di * di;
      (*b)[i] -= w * error * di;
      if (k < 0) return;
      (*S)(k, k) += w * dk * dk;
      (*S)(i, k) += w * di * dk;
      (*S)(k, i) += w * di * dk;
      (*b)[k] -= w * error * dk;
    };
    for (std::size_t m = 0; m < p_BM_.size(); ++m) {
      const Attachment& site = expected_.sites[m];
      const Vector3 error = p_BM_[m] - expected_.sites[m].p_BM;
      for (int a = 0; a < 3; ++a) {
        const int i = 3 * static_cast<int>(m) + a;
        const auto far = far_joint(site.segment);
        if (a == 2 && far && offset_[index(*far)][2] >= 0) {
          const double ratio = site.p_BM.z() / expected_.p_PB[index(*far)].z();
          add(p_BM_[m].z() - ratio * p_PB_[index(*far)].z(), expected_.spread[m].z(), i, 1.0,
              offset_[index(*far)][2], -ratio);
        } else {
          add(error[a], expected_.spread[m][a], i, 1.0, -1, 0.0);
        }
      }
    }
    constexpr double kSides = 0.007;  // left against right, 1 sigma [m]
    for (std::size_t j = 0; j < kJointCount; ++j) {
      const std::size_t other = index(mirrored(static_cast<Joint>(j)));
      for (std::size_t a = 0; a < 3; ++a) {
        const int i = offset_[j][a];
        const auto axis = static_cast<Eigen::Index>(a);
        if (i < 0) continue;
        add(p_PB_[j][axis] - expected_.p_PB[j][axis], expected_.p_PB_spread[j][axis], i, 1.0, -1,
            0.0);
        if (other <= j || offset_[other][a] < 0) continue;
        const double sign = a == 1 ? -1.0 : 1.0;
        add(p_PB_[j][axis] - sign * p_PB_[other][axis], kSides, i, 1.0, offset_[other][a], -sign);
      }
    }
    return cost;
  }

  // The markers' part of H_ps (into `right`), H_ss and g_s.
  void add_shared(const Shot& shot, double kernel, Eigen::MatrixXd& right, Eigen::MatrixXd& S,
                  Eigen::VectorXd& b, double lambda) const {
    const Skeleton& skeleton = solver_.skeleton();
    Eigen::Matrix3Xd J(3, PoseSolver::kMostDofs);
    struct Block {
      int column;
      Matrix3 J;
      std::array<int, 3> at;
    };
    std::vector<Block> blocks;
    for (std::size_t m = 0; m < p_BM_.size(); ++m) {
      if (!(shot.sigma[m] > 0.0)) continue;
      const std::size_t segment = index(expected_.sites[m].segment);
      const double information = 1.0 / (shot.sigma[m] * shot.sigma[m]);
      const Vector3 r = residual(shot, m);
      const double c2 = kernel * kernel;
      const double share = c2 / (c2 + information * r.squaredNorm());
      const double w = information * share * share;
      position_jacobian(skeleton, shot.pose.X_WB, segment, p_BM_[m], J);
      blocks.clear();
      const int first = 3 * static_cast<int>(m);
      blocks.push_back({0, shot.pose.X_WB[segment].linear(), {first, first + 1, first + 2}});
      for (std::size_t j = segment; j > 0; j = *skeleton[j].parent) {
        const auto& at = offset_[j];
        if (at[0] < 0 && at[1] < 0 && at[2] < 0) continue;
        blocks.push_back({0, shot.pose.X_WB[*skeleton[j].parent].linear(), at});
      }
      for (const Block& block : blocks) {
        for (std::size_t a = 0; a < 3; ++a) {
          if (block.at[a] < 0) continue;
          const Vector3 column = block.J.col(static_cast<Eigen::Index>(a));
          b[block.at[a]] += w * column.dot(r);
          right.col(block.at[a]).head<3>() += w * column;  // the root's position
          for (std::size_t j = segment;; j = *skeleton[j].parent) {
            if (const auto c = solver_.column(static_cast<Joint>(j))) {
              right.col(block.at[a]).segment<3>(*c) +=
                  w * J.middleCols<3>(3 + 3 * static_cast<Eigen::Index>(j)).transpose() * column;
            }
            if (j == 0) break;
          }
          for (const Block& other : blocks) {
            for (std::size_t k = 0; k < 3; ++k) {
              if (other.at[k] < 0) continue;
              const double damping = block.at[a] == other.at[k] ? 1.0 + lambda : 1.0;
              S(block.at[a], other.at[k]) +=
                  damping * w * column.dot(other.J.col(static_cast<Eigen::Index>(k)));
            }
          }
        }
      }
    }
  }

  const Expected& expected_;
  std::vector<Vector3> p_BM_, prior_;
  std::array<Vector3, kJointCount> p_PB_;
  std::array<std::array<int, 3>, kJointCount> offset_{};  // the unknown's index, or -1
  int shared_ = 0;
  PoseSolver solver_;
};

// ---------------------------------------------------------------------------------------------

// Frames that differ from each other as much as the trial allows (greedy k-centre), of those that
// show nearly as many markers as any.
std::vector<std::size_t> spread_frames(const std::vector<Attachment>& sites,
                                       const MarkerMotion& trial, std::size_t count) {
  constexpr std::size_t kCandidates = 400;
  const std::size_t step = std::max<std::size_t>(1, trial.frames.size() / kCandidates);
  std::size_t most = 0;
  const auto seen = [&](std::size_t f) {
    return static_cast<std::size_t>(
        std::count_if(sites.begin(), sites.end(),
                      [&](const Attachment& a) { return shows(trial.frames[f], a.marker); }));
  };
  for (std::size_t f = 0; f < trial.frames.size(); f += step) most = std::max(most, seen(f));
  std::vector<std::size_t> candidates;
  for (std::size_t f = 0; f < trial.frames.size(); f += step) {
    if (seen(f) * 10 >= most * 8) candidates.push_back(f);
  }
  if (most < MarkerSet::kLeastMarkers || candidates.empty()) {
    throw std::runtime_error(fmt::format("no frame shows {} of the set's markers at once; most: {}",
                                         MarkerSet::kLeastMarkers, most));
  }
  const auto centre = [&](std::size_t f) {
    Vector3 sum = Vector3::Zero();
    double n = 0.0;
    for (const Attachment& a : sites) {
      if (!shows(trial.frames[f], a.marker)) continue;
      sum += trial.frames[f].p_WM[a.marker];
      n += 1.0;
    }
    return Vector3(sum / n);
  };
  const auto distance = [&](std::size_t f, std::size_t g) {
    const Vector3 shift = centre(f) - centre(g);
    double sum = 0.0, n = 0.0;
    for (const Attachment& a : sites) {
      const MarkerFrame &x = trial.frames[f], &y = trial.frames[g];
      if (!shows(x, a.marker) || !shows(y, a.marker)) continue;
      sum += (x.p_WM[a.marker] - y.p_WM[a.marker] - shift).squaredNorm();
      n += 1.0;
    }
    return n > 0.0 ? sum / n : 0.0;
  };
  std::vector<std::size_t> chosen{candidates.front()};
  std::vector<double> nearest(candidates.size(), std::numeric_limits<double>::infinity());
  while (chosen.size() < std::min(count, candidates.size())) {
    std::size_t best = 0;
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      nearest[i] = std::min(nearest[i], distance(candidates[i], chosen.back()));
      if (nearest[i] > nearest[best]) best = i;
    }
    chosen.push_back(candidates[best]);
  }
  return chosen;
}

// Another trial's markers in the order of this one's; those that it lacks are not visible.
MarkerMotion with_names_of(const MarkerMotion& trial, const MarkerMotion& other) {
  MarkerMotion result{trial.names, other.rate_hz, {}};
  std::vector<std::optional<std::size_t>> from;
  for (const std::string& name : trial.names) from.push_back(other.find(name));
  for (const MarkerFrame& frame : other.frames) {
    MarkerFrame mine(trial.names.size());
    for (std::size_t i = 0; i < from.size(); ++i) {
      if (!from[i]) continue;
      mine.p_WM[i] = frame.p_WM[*from[i]];
      mine.visible[i] = frame.visible[*from[i]];
    }
    result.frames.push_back(std::move(mine));
  }
  return result;
}

// How a segment stands in the world, whatever its heading: tilt and obliquity as of the pelvis.
JointAngles attitude(const Isometry3d& X_WB) {
  return joint_angles(Joint::kPelvis, Quaterniond(X_WB.linear()));
}

// Moments of standing upright: knees and trunk straight, thighs vertical, the pelvis as high as
// ever.
std::vector<std::size_t> upright(const std::vector<Shot>& shots) {
  std::vector<std::size_t> straight;
  double highest = -std::numeric_limits<double>::infinity();
  const auto vertical = [](const Vector3& v, double degrees) {
    return v.z() > std::cos(degrees * kDegree) * v.norm();
  };
  for (std::size_t f = 0; f < shots.size(); ++f) {
    const auto& X = shots[f].pose.X_WB;
    const auto at = [&](Joint j) { return Vector3(X[index(j)].translation()); };
    bool is_straight = vertical(at(Joint::kNeck) - at(Joint::kPelvis), 20.0);
    for (const Joint hip : {Joint::kLeftHip, Joint::kRightHip}) {
      const Joint knee = static_cast<Joint>(index(hip) + 1);
      const Joint ankle = static_cast<Joint>(index(hip) + 2);
      const Vector3 thigh = at(hip) - at(knee), shank = at(knee) - at(ankle);
      is_straight = is_straight && vertical(thigh, 20.0) && vertical(shank, 25.0) &&
                    thigh.dot(shank) > std::cos(20.0 * kDegree) * thigh.norm() * shank.norm();
    }
    if (!is_straight) continue;
    straight.push_back(f);
    highest = std::max(highest, at(Joint::kPelvis).z());
  }
  constexpr double kAsHigh = 0.02;  // [m]
  std::erase_if(straight, [&](std::size_t f) {
    return shots[f].pose.X_WB[0].translation().z() < highest - kAsHigh;
  });
  return straight;
}

// A calibration with the names as they are, and what is odd about it.
struct Attempt {
  BodyCalibration calibration;
  double cost = 0.0;  // of one frame, in squares of sigmas
  struct Oddity {
    std::size_t site;
    double off;                        // typically that far off its place [m]
    double strange;                    // its place is that far from where the set has it [m]
    std::vector<std::size_t> perhaps;  // sites in whose place it would lie better
  };
  std::vector<Oddity> oddities;
};

std::vector<Attempt::Oddity> find_oddities(const Adjustment& adjustment, const Expected& expected,
                                           const std::vector<Shot>& shots) {
  const std::size_t n = expected.sites.size();
  // How far marker a typically is from a place on marker b's segment.
  const auto distance = [&](std::size_t a, std::size_t b, const Vector3& place) {
    std::vector<double> distances;
    for (const Shot& shot : shots) {
      if (!(shot.sigma[a] > 0.0)) continue;
      const Isometry3d& X_WB = shot.pose.X_WB[index(expected.sites[b].segment)];
      distances.push_back((X_WB * place - shot.p_WM[a]).norm());
    }
    return median(distances);
  };
  const auto& places = adjustment.places();
  std::vector<Attempt::Oddity> result;
  for (std::size_t a = 0; a < n; ++a) {
    const double off = distance(a, a, places[a]);
    const Vector3 from_expected = places[a] - adjustment.expected_place(a);
    const double strange = from_expected.cwiseQuotient(expected.spread[a]).norm() / std::sqrt(3.0);
    constexpr double kOff = 5.0, kStrange = 2.5;  // [sigma]
    if (off > kOff * expected.sites[a].sigma || strange > kStrange) {
      result.push_back({a, off, from_expected.norm(), {}});
    }
  }
  for (Attempt::Oddity& odd : result) {
    const double here = distance(odd.site, odd.site, adjustment.expected_place(odd.site));
    for (std::size_t b = 0; b < n; ++b) {
      if (b == odd.site) continue;
      // Its partner is odd too, or so near on the same segment that it could adapt.
      const bool same = expected.sites[b].segment == expected.sites[odd.site].segment;
      const bool also_odd = std::any_of(result.begin(), result.end(),
                                        [&](const Attempt::Oddity& o) { return o.site == b; });
      if (!same && !also_odd) continue;
      const bool sides =
          secondskin::mirrored(expected.sites[odd.site].segment) == expected.sites[b].segment;
      if (distance(odd.site, b, adjustment.expected_place(b)) < here || (sides && also_odd)) {
        odd.perhaps.push_back(b);
      }
    }
  }
  return result;
}

Attempt attempt(const MarkerSet& set, const MarkerMotion& trial,
                const std::optional<MarkerMotion>& still) {
  const Expected expected = expect(set, trial);
  Adjustment adjustment(expected);

  constexpr std::size_t kShots = 40, kStandingShots = 6;
  std::vector<Shot> shots;
  for (const std::size_t f : spread_frames(expected.sites, trial, kShots)) {
    shots.push_back(adjustment.shot(trial.frames[f]));
  }
  if (still) {
    for (const std::size_t f : spread_frames(expected.sites, *still, kStandingShots)) {
      shots.push_back(adjustment.shot(still->frames[f]));
    }
  }
  // First with room for an average body's errors (cm), then with the wearer's own.
  constexpr double kRoom = 4.0;
  double best = 0.0;
  std::vector<Shot> usable;
  for (Shot& shot : shots) {
    const double share = adjustment.pose_alone(shot, kRoom);
    best = std::max(best, share);
    if (share > 0.6) usable.push_back(shot);
  }
  if (usable.size() < std::min<std::size_t>(3, shots.size())) {
    throw std::runtime_error(fmt::format(
        "the markers lie on no body of set \"{}\": at best {:.0f} % of them are where they should "
        "be; are they named right, and is the up axis right (--up y|z)?",
        set.name(), 100.0 * best));
  }
  adjustment.adjust(usable, 12.0, 15);
  double cost = adjustment.adjust(usable, 6.0, 15);
  usable.clear();
  for (Shot& shot : shots) {
    if (adjustment.pose_alone(shot, 1.5) > 0.6) usable.push_back(shot);
  }
  if (!usable.empty()) cost = adjustment.adjust(usable, 4.0, 20);
  // A frame that shows no pose of this body costs what wrong markers cost at most.
  constexpr double kLost = 16.0;
  cost += kLost * static_cast<double>(expected.sites.size()) *
          static_cast<double>(shots.size() - usable.size()) / static_cast<double>(shots.size());

  // Poses through the trial, each from the one before.
  constexpr std::size_t kTracked = 300;
  const auto track = [&](const MarkerMotion& motion) {
    std::vector<Shot> tracked;
    const std::size_t step = std::max<std::size_t>(1, motion.frames.size() / kTracked);
    for (std::size_t f = 0; f < motion.frames.size(); f += step) {
      Shot shot = adjustment.shot(motion.frames[f]);
      PoseSolver::Matrix H;
      bool good = false;
      if (!tracked.empty()) {
        shot.pose = tracked.back().pose;
        adjustment.solver().solve({shot.p_WM, shot.sigma, 4.0, nullptr, nullptr}, 20, shot.pose, H);
        good = adjustment.share_in_place(shot, shot.sigma) > 0.8;
      }
      if (!good) {
        Shot fresh = shot;
        const double before = tracked.empty() ? 0.0 : adjustment.share_in_place(shot, shot.sigma);
        if (adjustment.pose_alone(fresh, 1.0) > before) shot = fresh;
        if (adjustment.share_in_place(shot, shot.sigma) < 0.4) continue;
      }
      tracked.push_back(std::move(shot));
    }
    return tracked;
  };
  BodyCalibration result{{expected.skeleton(), {}}, {}, 0.0, false};
  std::vector<Shot> tracked = track(trial);
  const std::vector<Shot> stood = still ? track(*still) : tracked;

  // Upside down?
  double heads_up = 0.0;
  for (const Shot& shot : tracked) {
    const auto& X = shot.pose.X_WB;
    heads_up += (X[index(Joint::kNeck)].translation() - X[0].translation()).normalized().z();
  }
  if (tracked.empty()) {
    throw std::runtime_error(fmt::format(
        "no frame shows a body of set \"{}\"; are the markers named right?", set.name()));
  }
  heads_up /= static_cast<double>(tracked.size());
  if (heads_up < -0.5) {
    throw std::runtime_error(
        "the head is below the hips: the up axis is wrong; say which is up (--up y|z)");
  }

  // The zero of the angles: what upright standing looks like on this wearer.
  const std::vector<std::size_t> moments = upright(stood);
  constexpr std::size_t kMoments = 3;
  if (moments.size() >= kMoments) {
    result.stood_upright = true;
    const auto typical = [&](Joint joint, Movement movement) {
      std::vector<double> values;
      for (const std::size_t f : moments) {
        values.push_back(
            attitude(stood[f].pose.X_WB[index(joint)])[static_cast<std::size_t>(movement)]);
      }
      return median(values);
    };
    for (const Joint joint :
         {Joint::kPelvis, Joint::kSpineLower, Joint::kSpineMiddle, Joint::kSpineUpper, Joint::kNeck,
          Joint::kHead, Joint::kLeftAnkle, Joint::kRightAnkle}) {
      if (!adjustment.solver().column(joint)) continue;
      const bool foot = joint >= Joint::kLeftHip;
      const double tilt = typical(joint, Movement::kFlexion);
      const double roll = foot ? typical(joint, Movement::kAbduction) : 0.0;
      adjustment.turn_frame(joint, Quaterniond(Eigen::AngleAxisd(-tilt, Vector3::UnitY()) *
                                               Eigen::AngleAxisd(-roll, Vector3::UnitX())));
    }
    tracked = track(trial);
  }

  // What each marker's distance from its place says.
  result.body.skeleton = adjustment.solver().skeleton();
  double sum = 0.0, count = 0.0;
  for (std::size_t m = 0; m < expected.sites.size(); ++m) {
    Attachment site = expected.sites[m];
    site.p_BM = adjustment.places()[m];
    MarkerReport report{site.name, 0.0, 0.0, ""};
    std::size_t visible = 0;
    for (const MarkerFrame& frame : trial.frames) visible += shows(frame, site.marker) ? 1 : 0;
    report.visible = static_cast<double>(visible) / static_cast<double>(trial.frames.size());
    std::vector<double> distances;
    double squares = 0.0;
    for (const Shot& shot : tracked) {
      if (!(shot.sigma[m] > 0.0)) continue;
      const double d = adjustment.residual(shot, m).norm();
      distances.push_back(d);
      squares += d * d;
    }
    if (!distances.empty()) {
      report.residual = std::sqrt(squares / static_cast<double>(distances.size()));
      sum += squares;
      count += static_cast<double>(distances.size());
      // Skin shifts slowly, so that a short trial tells too small a sway: the set's is the least.
      // 1.538 sigma is the median of the norm of three normal numbers.
      constexpr double kMost = 0.03;
      site.sigma = std::clamp(median(distances) / 1.538, site.sigma, std::max(site.sigma, kMost));
    }
    result.markers.push_back(report);
    result.body.attachments.push_back(site);
  }
  result.residual = count > 0.0 ? std::sqrt(sum / count) : 0.0;
  return {std::move(result), cost, find_oddities(adjustment, expected, tracked)};
}

}  // namespace

BodyCalibration calibrate_body(const MarkerSet& set, const MarkerMotion& trial,
                               const MarkerMotion* standing) {
  if (trial.frames.empty()) throw std::runtime_error("the trial has no frames");
  std::optional<MarkerMotion> still;
  if (standing != nullptr) still = with_names_of(trial, *standing);
  Attempt best = attempt(set, trial, still);

  // Where markers are odd, would the body fit much better if two of them had each other's names?
  MarkerMotion named = trial;
  std::vector<std::pair<std::string, std::string>> exchanged;
  constexpr std::size_t kMostExchanges = 4, kMostTries = 40;
  while (exchanged.size() < kMostExchanges && !best.oddities.empty()) {
    std::optional<Attempt> better;
    std::pair<std::size_t, std::size_t> pair;
    std::size_t tries = 0;
    for (const Attempt::Oddity& odd : best.oddities) {
      for (const std::size_t other : odd.perhaps) {
        const auto& sites = best.calibration.body.attachments;
        if (other < odd.site &&
            std::any_of(best.oddities.begin(), best.oddities.end(), [&](const Attempt::Oddity& o) {
              return o.site == other &&
                     std::count(o.perhaps.begin(), o.perhaps.end(), odd.site) > 0;
            })) {
          continue;  // tried the other way round
        }
        if (++tries > kMostTries) break;
        std::swap(named.names[sites[odd.site].marker], named.names[sites[other].marker]);
        try {
          Attempt next = attempt(set, named, still);
          constexpr double kMuchBetter = 0.75;
          if (next.cost < kMuchBetter * best.cost && (!better || next.cost < better->cost)) {
            better = std::move(next);
            pair = {sites[odd.site].marker, sites[other].marker};
          }
        } catch (const std::runtime_error&) {
          // Named so, it is no body at all.
        }
        std::swap(named.names[sites[odd.site].marker], named.names[sites[other].marker]);
      }
    }
    if (!better) break;
    exchanged.emplace_back(trial.names[pair.first], trial.names[pair.second]);
    std::swap(named.names[pair.first], named.names[pair.second]);
    best = *std::move(better);
  }

  for (const Attempt::Oddity& odd : best.oddities) {
    const Attachment& site = best.calibration.body.attachments[odd.site];
    std::string& suspicion = best.calibration.markers[odd.site].suspicion;
    if (odd.off > 5.0 * site.sigma) {
      suspicion = fmt::format("does not stay on {}: {:.0f} mm off its place",
                              joint_name(site.segment), 1e3 * odd.off);
    } else {
      suspicion = fmt::format("sits {:.0f} mm from where the set has it on {}", 1e3 * odd.strange,
                              joint_name(site.segment));
    }
  }
  // The reports and attachments speak of the trial's own names.
  for (std::size_t i = 0; i < best.calibration.markers.size(); ++i) {
    const std::string& name = trial.names[best.calibration.body.attachments[i].marker];
    best.calibration.markers[i].name = best.calibration.body.attachments[i].name = name;
    for (const auto& [a, b] : exchanged) {
      if (name != a && name != b) continue;
      best.calibration.markers[i].suspicion =
          fmt::format("is exchanged with {} and was taken for it", name == a ? b : a);
    }
  }
  return best.calibration;
}

}  // namespace secondskin::server
