#include "server/optical/calibrate/wand_calibration.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/QR>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <random>
#include <stdexcept>

#include "server/optical/calibrate/bundle.h"
#include "server/optical/calibrate/projector_fit.h"
#include "server/optical/calibrate/triangulation.h"
#include "wire/photo_tag.h"

namespace secondskin::server {
namespace {

// 2.3: the tracking volume, about the world's z axis [m].
constexpr double kVolumeRadius = 0.5 * 6.5 * 0.3048;
constexpr double kVolumeHeight = 6.0 * 0.3048;

constexpr std::size_t kApart = 5;          // cycles between frames that are solved for
constexpr std::size_t kStartPoints = 450;  // the factorisation's
constexpr std::size_t kJudged = 1500;      // frames that judge the result
constexpr std::size_t kProbes = 60;        // frames of which the error is predicted
constexpr std::size_t kLeastFrames = 100;
constexpr std::size_t kLeastSightings = 60;  // of a projector
constexpr double kGoodShare = 0.8;           // of a projector's sightings must fit
constexpr double kStillCounts = 1.5;         // a lying detector's values stay so near
constexpr double kFloorTolerance = 0.01;     // lay-downs on one floor [m]
constexpr double kThin = 0.1;                // least spread of the waved places [m]
constexpr double kSwept = 0.6;               // share of a projector's field that is enough
constexpr double kGoodLength = 5e-3;         // error of the wand's lengths [m]
constexpr double kNormal = 1.4826;           // standard deviation over median of |error|
constexpr std::size_t kDistanceBins = 4;

std::vector<Sighting> sightings_of(const SyncedFrame& frame, std::size_t detector) {
  std::vector<Sighting> out;
  for (std::size_t p = 0; p < frame.projectors; ++p) {
    if (const auto v = frame.value(detector, p)) out.push_back({p, *v});
  }
  return out;
}

void mirror(ProjectorRig& rig) {
  for (auto& projector : rig.projectors) {
    if (projector) projector->P.col(0) *= -1.0;
  }
}

// Moves the world: points go to scale * R p + t.
void move(ProjectorRig& rig, double scale, const Eigen::Matrix3d& R, const Eigen::Vector3d& t) {
  for (auto& projector : rig.projectors) {
    if (!projector) continue;
    Eigen::Matrix<double, 2, 4>& P = projector->P;
    P.leftCols<3>() = (P.leftCols<3>() * R.transpose() / scale).eval();
    P.col(3) -= P.leftCols<3>() * t;
    P /= P(1, 3);
  }
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

tl::unexpected<Refusal> refuse(RefusalKind kind, std::string text) {
  return tl::unexpected(Refusal{kind, std::move(text)});
}

// One solution from the frames of a session.
class Solver {
 public:
  Solver(const Wand& wand, std::size_t projectors, const WandSettings& settings,
         const std::vector<SyncedFrame>& frames,
         const std::vector<std::pair<std::size_t, std::size_t>>& lying)
      : wand_(wand), settings_(settings), frames_(frames), lying_(lying) {
    result_.rig.projectors.resize(projectors);
    result_.projectors.resize(projectors);
    const auto n = static_cast<Eigen::Index>(wand.lying_W.size());
    lengths_.resize(n, n);
    for (std::size_t a = 0; a < wand.lying_W.size(); ++a) {
      for (std::size_t b = 0; b < wand.lying_W.size(); ++b) {
        lengths_(static_cast<Eigen::Index>(a), static_cast<Eigen::Index>(b)) =
            (wand.lying_W[a] - wand.lying_W[b]).norm();
      }
    }
    bundle_.optics = settings.optics;
    bundle_.length_sigma = settings.length_sigma;
    if (settings.layout) guess_ = settings.layout->rig(settings.optics);
  }

  tl::expected<WandResult, Refusal> solve() {
    if (auto done = start(); !done) return tl::unexpected(done.error());
    if (auto done = refine(); !done) return tl::unexpected(done.error());
    if (auto done = lay_down(); !done) return tl::unexpected(done.error());
    judge();
    return std::move(result_);
  }

 private:
  using Done = tl::expected<void, Refusal>;

  // Frames some cycles apart, evenly over the session, at most so many.
  std::vector<std::size_t> spread(std::size_t most) const {
    const std::size_t step = std::max(
        {std::size_t{1}, std::min(kApart, frames_.size() / kLeastFrames), frames_.size() / most});
    std::vector<std::size_t> out;
    for (std::size_t f = step / 2; f < frames_.size(); f += step) {
      // Of the time that the wand lies one frame is as good as all.
      const bool lies = std::any_of(lying_.begin(), lying_.end(), [&](const auto& range) {
        return f >= range.first && f < range.second;
      });
      if (!lies) out.push_back(f);
    }
    return out;
  }

  BundleFrame place(const SyncedFrame& frame) const {
    BundleFrame out;
    for (std::size_t d = 0; d < frame.detectors; ++d) {
      std::vector<Sighting> sightings = sightings_of(frame, d);
      const auto found = triangulate(result_.rig, sightings);
      if (!found) continue;
      out.detectors.push_back(d);
      out.points.push_back(found->p_W);
      out.sightings.push_back(std::move(sightings));
    }
    return out;
  }

  // A first rig up to place, orientation and mirror; scaled by the wand.
  Done start() {
    std::vector<std::vector<Sighting>> points;
    std::vector<std::pair<std::size_t, std::size_t>> source;
    std::vector<std::size_t> seen(result_.projectors.size(), 0);
    const std::vector<std::size_t> chosen = spread(kStartPoints / wand_.lying_W.size() + 1);
    for (const std::size_t f : chosen) {
      for (std::size_t d = 0; d < wand_.lying_W.size(); ++d) {
        auto sightings = sightings_of(frames_[f], d);
        if (sightings.size() < 5) continue;
        for (const Sighting& s : sightings) ++seen[s.projector];
        points.push_back(std::move(sightings));
        source.emplace_back(f, d);
      }
    }
    const auto seeing =
        std::count_if(seen.begin(), seen.end(), [](std::size_t n) { return n >= 20; });
    if (points.size() < kLeastFrames || seeing < 5) {
      return refuse(RefusalKind::kTooFewPoints,
                    fmt::format("{} places seen by five projectors or more, and {} projectors that "
                                "saw the wand often; at least {} and 5 are needed",
                                points.size(), seeing, kLeastFrames));
    }
    const ProjectorRig* guess = guess_ ? &*guess_ : nullptr;
    auto found = factorise(points, result_.projectors.size(), settings_.optics, guess, 1);
    if (!found || found->residual > 2.0) {
      return refuse(RefusalKind::kDoesNotFit,
                    "no projectors explain the values; wave the wand through the whole volume and "
                    "turn it to all sides");
    }
    result_.rig = found->rig;

    // The wand's lengths as they came out, in units of the known ones.
    const std::size_t n = wand_.lying_W.size();
    std::vector<std::vector<double>> measured(n * n);
    for (std::size_t k = 0; k < points.size(); ++k) {
      for (std::size_t l = k + 1; l < points.size() && source[l].first == source[k].first; ++l) {
        if (!found->points[k] || !found->points[l]) continue;
        measured[source[k].second * n + source[l].second].push_back(
            (*found->points[k] - *found->points[l]).norm());
      }
    }
    std::vector<std::size_t> order(n), best_order;
    std::iota(order.begin(), order.end(), 0U);
    double best = 0.0, as_told = 0.0, scale = 1.0;
    do {
      std::vector<double> logs;
      for (std::size_t a = 0; a < n; ++a) {
        for (std::size_t b = a + 1; b < n; ++b) {
          if (measured[a * n + b].size() < 20) continue;
          logs.push_back(std::log(length(order[a], order[b]) / median(measured[a * n + b])));
        }
      }
      if (logs.empty()) {
        return refuse(RefusalKind::kTooFewPoints,
                      "two detectors of the wand were hardly ever seen at the same time");
      }
      const double mean =
          std::accumulate(logs.begin(), logs.end(), 0.0) / static_cast<double>(logs.size());
      double misfit = 0.0;
      for (const double l : logs) misfit = std::max(misfit, std::fabs(l - mean));
      if (best_order.empty()) {
        as_told = best = misfit;
        best_order = order;
        scale = std::exp(mean);
      } else if (misfit < best) {
        best = misfit;
        best_order = order;
      }
    } while (n <= 6 && std::next_permutation(order.begin(), order.end()));
    if (best < 0.3 * as_told && as_told > 0.08) {
      std::vector<std::size_t> wrong;
      for (std::size_t d = 0; d < n; ++d) {
        if (best_order[d] != d) wrong.push_back(d);
      }
      return refuse(RefusalKind::kExchanged,
                    fmt::format("the wand's detectors {} seem to be exchanged: in each other's "
                                "place its lengths fit",
                                fmt::join(wrong, " and ")));
    }
    move(result_.rig, scale, Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero());
    return {};
  }

  // Bundle adjustment over frames that spread over all fields; twice, for the first places are
  // rough. In between, projectors that the start left out are fitted to the places, and those whose
  // values do not fit are dropped.
  Done refine() {
    const std::size_t n_frames = settings_.frames;
    const std::array<std::size_t, 4> passes{n_frames / 2, n_frames, n_frames, 3 * n_frames};
    for (std::size_t pass = 0; pass < passes.size(); ++pass) {
      // The last one is for a wand that few projectors see at a time.
      if (pass == 3 && predicted_error(result_.rig, chosen_, bundle_,
                                       std::span(chosen_).first(std::min(
                                           kProbes, chosen_.size()))) < 0.8 * settings_.enough) {
        break;
      }
      std::vector<BundleFrame> placed;
      for (const std::size_t f : spread(3 * settings_.frames)) {
        if (BundleFrame frame = place(frames_[f]); !frame.points.empty()) {
          placed.push_back(std::move(frame));
        }
      }
      if (placed.size() < kLeastFrames / 2) {
        return refuse(RefusalKind::kDoesNotFit,
                      "the values do not agree on places of the wand; wave on, and more slowly");
      }
      if (pass > 0) fit_others(placed);
      chosen_ = choose(placed, passes[pass]);
      for (auto& range : lying_) {
        BundleFrame frame = place(mean_of(range));
        if (!frame.points.empty()) chosen_.push_back(std::move(frame));
      }
      if (!adjust(result_.rig, chosen_, lengths_, bundle_)) {
        return refuse(RefusalKind::kDoesNotFit, "the solver found no rig that fits");
      }
      drop_misfits(chosen_);
    }
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    double n = 0.0;
    for (const BundleFrame& f : chosen_) {
      for (const auto& p : f.points) {
        mean += p;
        ++n;
      }
    }
    mean /= n;
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (const BundleFrame& f : chosen_) {
      for (const auto& p : f.points) covariance += (p - mean) * (p - mean).transpose() / n;
    }
    const Eigen::Vector3d variance =
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(covariance, Eigen::EigenvaluesOnly)
            .eigenvalues();
    if (std::sqrt(std::max(0.0, variance[0])) < kThin) {
      return refuse(
          RefusalKind::kDegenerate,
          fmt::format("the wand stayed within {:.0f} mm of a plane; wave it through the volume, "
                      "low and high, to all sides",
                      1e3 * std::sqrt(std::max(0.0, variance[0]))));
    }
    return {};
  }

  // Frames that fill the bins of all projectors evenly, at most so many.
  std::vector<BundleFrame> choose(const std::vector<BundleFrame>& placed, std::size_t most) const {
    std::vector<std::size_t> order(placed.size());
    std::iota(order.begin(), order.end(), 0U);
    std::mt19937_64 random(2);
    std::shuffle(order.begin(), order.end(), random);
    std::vector<std::uint32_t> bins(result_.projectors.size() * ProjectorSweep::kBins, 0);
    const auto bin = [&](const Sighting& s) -> std::uint32_t& {
      return bins[s.projector * ProjectorSweep::kBins +
                  std::min<std::size_t>(ProjectorSweep::kBins - 1,
                                        static_cast<std::size_t>(s.value / 16.0))];
    };
    std::vector<BundleFrame> out;
    std::vector<bool> taken(placed.size(), false);
    for (const std::uint32_t quota : {8U, 32U, ~0U}) {
      for (const std::size_t f : order) {
        if (out.size() >= most) return out;
        if (taken[f]) continue;
        bool wanted = false;
        for (const auto& sightings : placed[f].sightings) {
          for (const Sighting& s : sightings) wanted = wanted || bin(s) < quota;
        }
        if (!wanted) continue;
        for (const auto& sightings : placed[f].sightings) {
          for (const Sighting& s : sightings) ++bin(s);
        }
        taken[f] = true;
        out.push_back(placed[f]);
      }
    }
    return out;
  }

  void fit_others(const std::vector<BundleFrame>& placed) {
    for (std::size_t i = 0; i < result_.projectors.size(); ++i) {
      if (result_.rig.projectors[i] || result_.projectors[i].refused) continue;
      std::vector<Reading> readings;
      for (const BundleFrame& f : placed) {
        for (std::size_t k = 0; k < f.points.size(); ++k) {
          for (const Sighting& s : f.sightings[k]) {
            if (s.projector == i) readings.push_back({f.points[k], s.value});
          }
        }
      }
      if (readings.size() < kLeastSightings) continue;
      const auto fit = fit_projector(readings);
      if (fit &&
          static_cast<double>(fit->fitting) > kGoodShare * static_cast<double>(readings.size())) {
        result_.rig.projectors[i] = fit->projector;
      }
    }
  }

  void drop_misfits(const std::vector<BundleFrame>& frames) {
    std::vector<std::size_t> all(result_.projectors.size(), 0), fitting(all);
    for (const BundleFrame& f : frames) {
      for (std::size_t k = 0; k < f.points.size(); ++k) {
        for (const Sighting& s : f.sightings[k]) {
          const auto& projector = result_.rig.projectors[s.projector];
          if (!projector) continue;
          ++all[s.projector];
          if (std::fabs(projector->value(f.points[k]) - s.value) <= kFits) ++fitting[s.projector];
        }
      }
    }
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (!result_.rig.projectors[i]) continue;
      const double share =
          all[i] > 0 ? static_cast<double>(fitting[i]) / static_cast<double>(all[i]) : 0.0;
      if (all[i] >= kLeastSightings / 2 && share >= kGoodShare) continue;
      result_.rig.projectors[i].reset();
      if (all[i] < kLeastSightings / 2) continue;
      result_.projectors[i].refused =
          Refusal{RefusalKind::kDoesNotFit,
                  fmt::format("only {:.0f} % of its values fit the other projectors; was it moved "
                              "while the wand was waved?",
                              100.0 * share)};
    }
  }

  // The values of the time that the wand lay: the mean of their middle half, for at its ends the
  // wand was perhaps still moving.
  SyncedFrame mean_of(const std::pair<std::size_t, std::size_t>& range) const {
    SyncedFrame out = frames_[range.first];
    for (std::size_t k = 0; k < out.values.size(); ++k) {
      std::vector<double> values;
      for (std::size_t f = range.first; f < range.second; ++f) {
        if (!std::isnan(frames_[f].values[k])) values.push_back(frames_[f].values[k]);
      }
      out.values[k] = std::numeric_limits<float>::quiet_NaN();
      if (2 * values.size() < range.second - range.first) continue;
      std::sort(values.begin(), values.end());
      const std::size_t quarter = values.size() / 4;
      double sum = 0.0;
      for (std::size_t j = quarter; j < values.size() - quarter; ++j) sum += values[j];
      out.values[k] = static_cast<float>(sum / static_cast<double>(values.size() - 2 * quarter));
    }
    return out;
  }

  struct Lain {
    std::size_t detector;
    Eigen::Vector3d p;
  };

  // Gives the rig its world: floor and mirror image, then origin and x.
  Done lay_down() {
    std::vector<std::vector<Lain>> lain;
    for (const auto& range : lying_) {
      const BundleFrame frame = place(mean_of(range));
      std::vector<Lain> places;
      for (std::size_t k = 0; k < frame.points.size(); ++k) {
        places.push_back({frame.detectors[k], frame.points[k]});
      }
      if (!places.empty()) lain.push_back(std::move(places));
    }
    const std::size_t whole = wand_.on_a_line() ? 2 : wand_.lying_W.size();
    if (lain.empty() || lain.front().size() < whole) {
      return refuse(RefusalKind::kNoFloor,
                    lying_.empty() ? "the wand never lay still; lay it on the floor for two seconds"
                                   : "where the wand lay not all of its detectors are seen by four "
                                     "projectors; lay it elsewhere or higher");
    }
    // The mirror image: by the layout, or by the wand's triangle, which appears turned over.
    if (wand_.on_a_line()) {
      if (!guess_) {
        return refuse(RefusalKind::kMirror,
                      "a wand with its detectors on one line cannot tell the world from its mirror "
                      "image; give a rough layout of the projectors, or use three detectors");
      }
      if (mirrored_against_guess()) mirror_all(lain);
    }
    if (auto done = level(lain); !done) return done;
    if (!wand_.on_a_line() &&
        turn_of(lain.front(), true).misfit < turn_of(lain.front(), false).misfit) {
      mirror_all(lain);
      if (auto done = level(lain); !done) return done;
    }
    // Origin and x: the wand as it first lay.
    const Turn turn = turn_of(lain.front(), false);
    Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
    R.topLeftCorner<2, 2>() = turn.R;
    apply(R, Eigen::Vector3d(turn.t.x(), turn.t.y(), 0.0), lain);
    if (const double misfit = turn_of(lain.front(), false).misfit; misfit > 2.0 * kFloorTolerance) {
      return refuse(RefusalKind::kNoFloor,
                    fmt::format("the wand as it lay does not have its own shape: {:.0f} mm off; "
                                "are its detectors in the order of its file?",
                                1e3 * misfit));
    }
    return {};
  }

  // Turns and lifts so that the lying detectors have the wand's heights, the waved ones above.
  Done level(std::vector<std::vector<Lain>>& lain) {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    double n = 0.0;
    for (const auto& places : lain) {
      for (const Lain& l : places) {
        mean += l.p;
        ++n;
      }
    }
    mean /= n;
    Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
    for (const auto& places : lain) {
      for (const Lain& l : places) covariance += (l.p - mean) * (l.p - mean).transpose() / n;
    }
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(covariance);
    if (eigen.eigenvalues()[1] < 0.05 * 0.05) {
      return refuse(RefusalKind::kNoFloor,
                    "the places where the wand lay are on one line; lay it down at three places "
                    "or more, in different directions");
    }
    Eigen::Vector3d up = eigen.eigenvectors().col(0);
    double above = 0.0;
    for (const BundleFrame& f : chosen_) {
      for (const auto& p : f.points) above += (p - mean).dot(up);
    }
    if (above < 0.0) up = -up;
    apply(Eigen::Quaterniond::FromTwoVectors(up, Eigen::Vector3d::UnitZ()).toRotationMatrix(),
          Eigen::Vector3d::Zero(), lain);
    double square = 0.0;
    for (int iteration = 0; iteration < 3; ++iteration) {
      Eigen::MatrixX3d A(static_cast<Eigen::Index>(n), 3);
      Eigen::VectorXd b(A.rows());
      Eigen::Index row = 0;
      for (const auto& places : lain) {
        for (const Lain& l : places) {
          A.row(row) << l.p.y(), -l.p.x(), 1.0;
          b[row++] = wand_.lying_W[l.detector].z() - l.p.z();
        }
      }
      const Eigen::Vector3d x = A.colPivHouseholderQr().solve(b);
      const Eigen::Vector3d turn(x[0], x[1], 0.0);
      apply(turn.norm() > 0.0 ? Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix()
                              : Eigen::Matrix3d::Identity(),
            Eigen::Vector3d(0.0, 0.0, x[2]), lain);
      square = 0.0;
      for (const auto& places : lain) {
        for (const Lain& l : places) {
          square += std::pow(l.p.z() - wand_.lying_W[l.detector].z(), 2);
        }
      }
    }
    result_.floor_rms = std::sqrt(square / n);
    if (result_.floor_rms > kFloorTolerance) {
      return refuse(RefusalKind::kNoFloor,
                    fmt::format("the wand lay still {} times, and not on one floor: {:.0f} mm RMS; "
                                "hold it still nowhere but on the floor",
                                lain.size(), 1e3 * result_.floor_rms));
    }
    return {};
  }

  struct Turn {
    Eigen::Matrix2d R;
    Eigen::Vector2d t;
    double misfit;  // RMS [m]
  };

  // The turn and shift on the floor that brings the lying wand to its own places, the wand seen
  // from above or from below.
  Turn turn_of(const std::vector<Lain>& places, bool from_below) const {
    const auto from = [&](const Lain& l) {
      return Eigen::Vector2d(from_below ? -l.p.x() : l.p.x(), l.p.y());
    };
    const auto to = [&](const Lain& l) -> Eigen::Vector2d {
      return wand_.lying_W[l.detector].head<2>();
    };
    const auto n = static_cast<double>(places.size());
    Eigen::Vector2d mean_from = Eigen::Vector2d::Zero(), mean_to = mean_from;
    for (const Lain& l : places) {
      mean_from += from(l) / n;
      mean_to += to(l) / n;
    }
    double cosine = 0.0, sine = 0.0;
    for (const Lain& l : places) {
      const Eigen::Vector2d a = from(l) - mean_from, b = to(l) - mean_to;
      cosine += a.dot(b);
      sine += a.x() * b.y() - a.y() * b.x();
    }
    Turn turn;
    turn.R = Eigen::Rotation2Dd(std::atan2(sine, cosine)).toRotationMatrix();
    turn.t = mean_to - turn.R * mean_from;
    double square = 0.0;
    for (const Lain& l : places) square += (turn.R * from(l) + turn.t - to(l)).squaredNorm();
    turn.misfit = std::sqrt(square / n);
    return turn;
  }

  void apply(const Eigen::Matrix3d& R, const Eigen::Vector3d& t,
             std::vector<std::vector<Lain>>& lain) {
    move(result_.rig, 1.0, R, t);
    for (BundleFrame& f : chosen_) {
      for (auto& p : f.points) p = R * p + t;
    }
    for (auto& places : lain) {
      for (Lain& l : places) l.p = R * l.p + t;
    }
  }

  void mirror_all(std::vector<std::vector<Lain>>& lain) {
    mirror(result_.rig);
    for (BundleFrame& f : chosen_) {
      for (auto& p : f.points) p.x() *= -1.0;
    }
    for (auto& places : lain) {
      for (Lain& l : places) l.p.x() *= -1.0;
    }
  }

  // Whether the places are nearer to the layout's when they are mirrored.
  bool mirrored_against_guess() const {
    std::vector<Eigen::Vector3d> here, there;
    for (const BundleFrame& f : chosen_) {
      for (std::size_t k = 0; k < f.points.size(); ++k) {
        Eigen::Matrix3d A = 1e-6 * Eigen::Matrix3d::Identity();
        Eigen::Vector3d b = Eigen::Vector3d::Zero();
        for (const Sighting& s : f.sightings[k]) {
          const Plane plane = guess_->projectors[s.projector]->plane(s.value);
          A += plane.a * plane.a.transpose() / plane.a.squaredNorm();
          b += plane.b * plane.a / plane.a.squaredNorm();
        }
        here.push_back(f.points[k]);
        there.push_back(A.ldlt().solve(b));
      }
    }
    Eigen::Matrix3Xd from(3, static_cast<Eigen::Index>(here.size()));
    Eigen::Matrix3Xd to(3, from.cols());
    for (std::size_t k = 0; k < here.size(); ++k) {
      from.col(static_cast<Eigen::Index>(k)) = here[k];
      to.col(static_cast<Eigen::Index>(k)) = there[k];
    }
    const auto misfit = [&] {
      const Eigen::Matrix4d T = Eigen::umeyama(from, to, false);
      return (((T.topLeftCorner<3, 3>() * from).colwise() + T.topRightCorner<3, 1>()) - to)
          .colwise()
          .norm()
          .mean();
    };
    const double straight = misfit();
    from.row(0) *= -1.0;
    return misfit() < straight;
  }

  // Residuals over the whole session, coverage, what is missing.
  void judge() {
    struct Sum {
      double square = 0.0;
      std::size_t fitting = 0;
      std::vector<std::uint32_t> bins =
          std::vector<std::uint32_t>(ProjectorSweep::kBins * kDistanceBins, 0);
    };
    std::vector<Sum> sums(result_.projectors.size());
    std::vector<BundleFrame> probes;
    std::vector<double> length_errors;
    const std::vector<std::size_t> judged = spread(kJudged);
    for (std::size_t j = 0; j < judged.size(); ++j) {
      BundleFrame frame = place(frames_[judged[j]]);
      for (std::size_t a = 0; a < frame.points.size(); ++a) {
        for (const Sighting& s : frame.sightings[a]) {
          const auto& projector = result_.rig.projectors[s.projector];
          ++result_.projectors[s.projector].sightings;
          if (!projector) continue;
          const double r = projector->value(frame.points[a]) - s.value;
          if (std::fabs(r) > kFits) continue;
          Sum& sum = sums[s.projector];
          ++sum.fitting;
          sum.square += r * r;
          ++sum.bins[bin(*projector, frame.points[a], s.value)];
        }
        for (std::size_t b = a + 1; b < frame.points.size(); ++b) {
          length_errors.push_back(std::fabs((frame.points[a] - frame.points[b]).norm() -
                                            length(frame.detectors[a], frame.detectors[b])));
        }
      }
      if (probes.size() < kProbes && j % std::max<std::size_t>(1, judged.size() / kProbes) == 0 &&
          !frame.points.empty()) {
        probes.push_back(std::move(frame));
      }
    }
    result_.frames = chosen_.size();
    if (!length_errors.empty()) {
      result_.length_error = kNormal * median(std::move(length_errors));
    }
    result_.predicted_error = predicted_error(result_.rig, chosen_, bundle_, probes);

    const auto wish = [&](std::string text) { result_.wishes.push_back(std::move(text)); };
    for (std::size_t i = 0; i < sums.size(); ++i) {
      WandProjector& report = result_.projectors[i];
      const auto& projector = result_.rig.projectors[i];
      if (!projector) {
        if (!report.refused) {
          report.refused =
              Refusal{RefusalKind::kTooFewPoints,
                      report.sightings == 0
                          ? std::string("no values at all: is it dark, or unplugged?")
                          : fmt::format("{} values at places that others see too; {} are needed",
                                        report.sightings, kLeastSightings)};
        }
        wish(fmt::format("projector {} is not calibrated: {}", i, report.refused->text));
        continue;
      }
      const auto fitting = static_cast<double>(sums[i].fitting);
      report.fitting = fitting / static_cast<double>(std::max<std::size_t>(1, report.sightings));
      report.residual = std::sqrt(sums[i].square / std::max(1.0, fitting));
      const Eigen::RowVector3d p1 = projector->P.row(0).head<3>(),
                               p2 = projector->P.row(1).head<3>();
      report.middle = p1.dot(p2) / p2.squaredNorm();
      report.focal = (p1 - report.middle * p2).norm() / p2.norm();
      const std::vector<std::uint32_t> reachable = reachable_bins(*projector);
      std::size_t of = 0, swept = 0;
      std::size_t worst_swept = kDistanceBins + 1, worst_bin = 0;
      for (std::size_t v = 0; v < ProjectorSweep::kBins; ++v) {
        std::size_t here = 0, possible = 0;
        for (std::size_t z = 0; z < kDistanceBins; ++z) {
          const std::size_t b = v * kDistanceBins + z;
          if (reachable[b] == 0) continue;
          ++possible;
          if (sums[i].bins[b] >= 3) ++here;
        }
        of += possible;
        swept += here;
        if (possible > 1 && here < worst_swept) {
          worst_swept = here;
          worst_bin = v;
        }
      }
      report.field_share = of > 0 ? static_cast<double>(swept) / static_cast<double>(of) : 0.0;
      if (report.field_share < kSwept) {
        wish(
            fmt::format("projector {}: {:.0f} % of its field is swept, {:.0f} % are enough; wave "
                        "where its value is about {}",
                        i, 100.0 * report.field_share, 100.0 * kSwept, 16 * worst_bin + 8));
      }
    }
    if (result_.predicted_error > settings_.enough) {
      wish(fmt::format("points would be uncertain by {:.1f} mm, {:.1f} mm is enough; wave on",
                       1e3 * result_.predicted_error, 1e3 * settings_.enough));
    }
    if (result_.length_error > kGoodLength) {
      wish(
          fmt::format("the wand's lengths come out {:.1f} mm wrong; is it bent or measured "
                      "wrongly?",
                      1e3 * result_.length_error));
    }
  }

  // Distance bins lie about the volume's middle.
  static std::size_t bin(const Projector& projector, const Eigen::Vector3d& p_W, double value) {
    const Eigen::RowVector3d z = projector.P.row(1).head<3>().normalized();
    const double along = z.dot((p_W - Eigen::Vector3d(0.0, 0.0, 0.5 * kVolumeHeight)).transpose());
    const double u = (along / kVolumeRadius + 1.0) * 0.5 * static_cast<double>(kDistanceBins);
    const auto distance =
        static_cast<std::size_t>(std::clamp(u, 0.0, static_cast<double>(kDistanceBins) - 1e-9));
    const auto v = static_cast<std::size_t>(
        std::clamp(value / 16.0, 0.0, static_cast<double>(ProjectorSweep::kBins) - 1e-9));
    return v * kDistanceBins + distance;
  }

  // The bins that the tracking volume fills.
  static std::vector<std::uint32_t> reachable_bins(const Projector& projector) {
    std::vector<std::uint32_t> bins(ProjectorSweep::kBins * kDistanceBins, 0);
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> uniform;
    for (int k = 0; k < 4000; ++k) {
      const double r = kVolumeRadius * std::sqrt(uniform(random));
      const double a = 2.0 * std::numbers::pi * uniform(random);
      const Eigen::Vector3d p(r * std::cos(a), r * std::sin(a), kVolumeHeight * uniform(random));
      const double v = projector.value(p);
      if (v > 1.0 && v < 254.0) ++bins[bin(projector, p, v)];
    }
    for (auto& b : bins) b = b >= 25 ? b : 0;
    return bins;
  }

  double length(std::size_t a, std::size_t b) const {
    return lengths_(static_cast<Eigen::Index>(a), static_cast<Eigen::Index>(b));
  }

  const Wand& wand_;
  const WandSettings& settings_;
  const std::vector<SyncedFrame>& frames_;
  const std::vector<std::pair<std::size_t, std::size_t>>& lying_;
  Eigen::MatrixXd lengths_;
  BundleSettings bundle_;
  std::optional<ProjectorRig> guess_;
  std::vector<BundleFrame> chosen_;
  WandResult result_;
};

}  // namespace

bool Wand::on_a_line() const {
  const Eigen::Vector3d along = (lying_W[1] - lying_W[0]).normalized();
  return std::all_of(lying_W.begin(), lying_W.end(), [&](const Eigen::Vector3d& p) {
    return (p - lying_W[0]).cross(along).norm() < 0.05;
  });
}

double ProjectorSweep::share() const noexcept {
  const auto full =
      std::count_if(values.begin(), values.end(), [](std::uint32_t n) { return n >= kFull; });
  return static_cast<double>(full) / static_cast<double>(kBins);
}

WandSession::WandSession(Wand wand, std::size_t projectors, WandSettings settings)
    : wand_(std::move(wand)),
      projectors_(projectors),
      settings_(std::move(settings)),
      sync_(wand_.lying_W.size(), projectors) {
  if (wand_.lying_W.size() < 2) {
    throw std::invalid_argument("a wand needs two detectors at least");
  }
  for (std::size_t a = 0; a < wand_.lying_W.size(); ++a) {
    for (std::size_t b = a + 1; b < wand_.lying_W.size(); ++b) {
      if ((wand_.lying_W[a] - wand_.lying_W[b]).norm() < 0.02) {
        throw std::invalid_argument(
            fmt::format("the wand's detectors {} and {} are at one place", a, b));
      }
    }
  }
  if (settings_.layout && settings_.layout->places.size() != projectors) {
    throw std::invalid_argument(fmt::format("the layout has {} projectors; expected {}",
                                            settings_.layout->places.size(), projectors));
  }
  progress_.projectors.resize(projectors);
}

void WandSession::add(const ProjectorFrame& frame) {
  auto synced = sync_.add(frame);
  if (!synced) return;
  bool place = false;
  for (std::size_t d = 0; d < synced->detectors; ++d) {
    const auto sightings = sightings_of(*synced, d);
    place = place || sightings.size() >= 4;
    for (const Sighting& s : sightings) {
      ++progress_.projectors[s.projector].values[static_cast<std::size_t>(s.value / 16.0)];
    }
  }
  if (place) ++progress_.frames;
  frames_.push_back(std::move(*synced));
  find_still(frames_.back());
}

void WandSession::find_still(const SyncedFrame& frame) {
  const SyncedFrame& first = frames_[still_since_];
  std::size_t common = 0, moved = 0;
  for (std::size_t k = 0; k < frame.values.size(); ++k) {
    if (std::isnan(frame.values[k]) || std::isnan(first.values[k])) continue;
    ++common;
    if (std::fabs(frame.values[k] - first.values[k]) > kStillCounts) ++moved;
  }
  if (common < 4 || moved > common / 10) {
    still_since_ = frames_.size() - 1;
    progress_.still = false;
    return;
  }
  const double still = 1e-9 * static_cast<double>(frame.stamp_ns - first.stamp_ns);
  if (still < kStill) return;
  if (!progress_.still) {
    progress_.still = true;
    ++progress_.lay_downs;
    lying_.emplace_back(still_since_, frames_.size());
  }
  lying_.back().second = frames_.size();
}

tl::expected<WandResult, Refusal> WandSession::solve() const {
  if (progress_.frames < kLeastFrames) {
    return refuse(RefusalKind::kTooFewPoints,
                  fmt::format("{} frames with a detector that four projectors see; at least {} are "
                              "needed",
                              progress_.frames, kLeastFrames));
  }
  return Solver(wand_, projectors_, settings_, frames_, lying_).solve();
}

}  // namespace secondskin::server
