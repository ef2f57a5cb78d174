// How far do root and segments stray: over the ground with and without foot contacts (virtual
// garment), and on real inertial recordings next to optical markers and to a suit's own filter?
// docs/wearable.md quotes the output.

#include <fmt/core.h>
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <Eigen/SVD>
#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "bench/wearable_runs.h"
#include "server/wearable/csv/csv_stream.h"
#include "server/wearable/wearable_source.h"
#include "sim/wearable/worn_garment.h"

namespace {

using namespace secondskin;
using namespace secondskin::bench;
using namespace secondskin::server;
namespace fs = std::filesystem;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using nlohmann::json;

std::FILE* table = stdout;  // with --json the table goes to stderr

struct Bench {
  fs::path data, repository = SECONDSKIN_SOURCE_DIR;
  double seconds = 60.0;
  int seeds = 3;
  json report;

  void root();
  void smoothing();
  void feet();
  void arm();
  void one_foot(std::size_t which, const char* name);
};

// -------------------------------------------------------------------------------------------------
// Root over the ground.

struct Drift {
  double metres = 0.0, heading = 0.0, walked = 0.0, minutes = 0.0, height = 0.0;
};

Drift drift(const sim::WornGarment& worn, std::uint64_t seed, bool contacts) {
  WearableOptions options;
  options.use_contacts = contacts;
  options.start.body = worn.assumed_skeleton();
  WearableSource source(std::make_unique<sim::SimulatedMeasurements>(worn, seed), worn.garment(),
                        options);
  StampedPose pose;
  Pose truth(kJointCount);
  std::optional<Eigen::Isometry3d> X_WT;  // the truth's world in ours, level
  Drift out;
  Vector3d before = Vector3d::Zero();
  double first = 0.0, last = 0.0;
  const auto heading = [](const Eigen::Quaterniond& q) {
    const Vector3d x = q * Vector3d::UnitX();
    return std::atan2(x.y(), x.x());
  };
  while (source.next(pose) == Next::kPose) {
    last = 1e-9 * static_cast<double>(pose.stamp_ns);
    worn.pose_at(last, truth);
    if (!X_WT) {
      first = last;
      X_WT = Eigen::Isometry3d::Identity();
      X_WT->linear() =
          Eigen::AngleAxisd(heading(pose.pose.q_PB[0]) - heading(truth.q_PB[0]), Vector3d::UnitZ())
              .toRotationMatrix();
      X_WT->translation() = pose.pose.p_WR - X_WT->linear() * truth.p_WR;
      before = truth.p_WR;
    }
    const Vector3d step = truth.p_WR - before;
    if (step.head<2>().norm() > 0.05) {  // in strides of 5 cm: sway is no way
      out.walked += step.head<2>().norm();
      before = truth.p_WR;
    }
    const Vector3d off = pose.pose.p_WR - *X_WT * truth.p_WR;
    out.metres = off.head<2>().norm();
    out.height = std::max(out.height, std::abs(off.z()));
    out.heading = std::abs(std::remainder(
        heading(pose.pose.q_PB[0]) - heading(Eigen::Quaterniond(X_WT->linear()) * truth.q_PB[0]),
        2.0 * std::numbers::pi));
  }
  out.minutes = (last - first) / 60.0;
  return out;
}

void Bench::root() {
  fmt::print(table, "Root over the ground, virtual garment, {} s, mean of {} seeds\n", seconds,
             seeds);
  fmt::print(table, "{:26} {:>9} {:>8} {:>10} {:>10} {:>10} {:>9}\n", "motion", "contacts",
             "walked m", "m/min", "cm/m", "deg/min", "height m");
  const Garment garment = Garment::load(repository / "garments/practical.toml");
  for (const char* name :
       {"cmu/135_09_oiduki.bvh", "cmu/135_05_gedanbarai.bvh", "cmu/131_01.bvh", "cmu/13_26.bvh"}) {
    if (!fs::exists(data / "bvh" / name)) {
      fmt::print(table, "{:26} absent\n", name);
      continue;
    }
    const Motion motion =
        stretched(read_canonical(data / "bvh" / name, repository / "joint_maps"), seconds);
    for (const bool contacts : {false, true}) {
      Drift sum;
      for (int seed = 1; seed <= seeds; ++seed) {
        const sim::WornGarment worn(motion, garment, sim::WornErrors{},
                                    static_cast<std::uint64_t>(seed));
        const Drift one = drift(worn, static_cast<std::uint64_t>(seed), contacts);
        sum.metres += one.metres / one.minutes;
        sum.heading += deg(one.heading) / one.minutes;
        sum.walked += one.walked;
        sum.minutes += one.minutes;
        sum.height = std::max(sum.height, one.height);
      }
      const double n = seeds, per_metre = sum.metres / n * (sum.minutes / n) / (sum.walked / n);
      fmt::print(table, "{:26} {:>9} {:8.1f} {:10.2f} {:10.1f} {:10.1f} {:9.2f}\n", name,
                 contacts ? "yes" : "no", sum.walked / n, sum.metres / n, 100.0 * per_metre,
                 sum.heading / n, sum.height);
      report["root"].push_back({{"motion", name},
                                {"contacts", contacts},
                                {"walked_m", sum.walked / n},
                                {"m_per_min", sum.metres / n},
                                {"m_per_m", per_metre},
                                {"deg_per_min", sum.heading / n},
                                {"height_m", sum.height}});
    }
  }
}

// -------------------------------------------------------------------------------------------------
// Filter and smoother, on the same measurements.

void Bench::smoothing() {
  constexpr std::array kJoints{Joint::kHead,       Joint::kRightShoulder, Joint::kRightElbow,
                               Joint::kRightWrist, Joint::kLeftHip,       Joint::kLeftKnee};
  fmt::print(table, "Orientation under the root, mean of six segments and {} seeds\n", seeds);
  const Garment garment = Garment::load(repository / "garments/practical.toml");
  for (const char* name : {"cmu/14_14.bvh", "cmu/135_05_gedanbarai.bvh"}) {
    if (!fs::exists(data / "bvh" / name)) {
      fmt::print(table, "{:26} absent\n", name);
      continue;
    }
    const Motion motion = stretched(read_canonical(data / "bvh" / name, repository / "joint_maps"),
                                    std::min(seconds, 20.0));
    std::array<double, 2> mean{}, rough{};
    for (int seed = 1; seed <= seeds; ++seed) {
      const sim::WornGarment worn(motion, garment, sim::WornErrors{},
                                  static_cast<std::uint64_t>(seed));
      for (const bool smooth : {false, true}) {
        WearableOptions options;
        options.start.body = worn.assumed_skeleton();
        options.smooth = smooth;
        WearableSource source(
            std::make_unique<sim::SimulatedMeasurements>(worn, static_cast<std::uint64_t>(seed)),
            garment, options);
        StampedPose pose, before;
        Pose truth(kJointCount), truth_before(kJointCount);
        double sum = 0.0, turns = 0.0, n = 0.0;
        while (source.next(pose) == Next::kPose) {
          worn.pose_at(1e-9 * static_cast<double>(pose.stamp_ns), truth);
          for (const Joint joint : kJoints) {
            sum += error_under_root(source.skeleton(), pose.pose, truth, joint);
            // How far each pose turns from the one before, against the truth's turn.
            if (n > 0.0) {
              const auto turn = [&](const Pose& a, const Pose& b) {
                const std::size_t i = index(joint);
                return rotation_vector(a.q_PB[i].conjugate() * b.q_PB[i]);
              };
              turns += (turn(before.pose, pose.pose) - turn(truth_before, truth)).norm();
            }
          }
          n += 1.0;
          before = pose;
          truth_before = truth;
        }
        mean[smooth] += deg(sum) / n / kJoints.size() / seeds;
        rough[smooth] += deg(turns) / n / kJoints.size() / seeds * source.rate_hz();
      }
    }
    fmt::print(table,
               "{:26} filter {:.2f} deg, smoother {:.2f} deg; rates off by {:.1f} and {:.1f} "
               "deg/s\n",
               name, mean[0], mean[1], rough[0], rough[1]);
    report["smoother"].push_back({{"motion", name},
                                  {"filter_deg", mean[0]},
                                  {"smoother_deg", mean[1]},
                                  {"filter_deg_s", rough[0]},
                                  {"smoother_deg_s", rough[1]}});
  }
}

// -------------------------------------------------------------------------------------------------
// Comparing orientations in different worlds and with different axes.

struct Comparison {
  double heading = 0.0;                       ///< of the reference's world in ours [rad]
  Matrix3d axes = Matrix3d::Identity();       ///< R of the reference's segment in ours
  double rmse = 0.0, tilt = 0.0, rate = 0.0;  ///< [rad], [rad], [rad/s]
  double worst = 0.0;
};

Matrix3d nearest_rotation(const Matrix3d& M) {
  const Eigen::JacobiSVD<Matrix3d> svd(M, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Matrix3d D = Matrix3d::Identity();
  D(2, 2) = (svd.matrixU() * svd.matrixV().transpose()).determinant();
  return svd.matrixU() * D * svd.matrixV().transpose();
}

Matrix3d about_z(double angle) {
  return Eigen::AngleAxisd(angle, Vector3d::UnitZ()).toRotationMatrix();
}

// One constant heading between the worlds and, where asked, one constant rotation between the
// segment's axes is taken out: the first cannot be observed, the second is a convention.
Comparison compare(const std::vector<Matrix3d>& ours, const std::vector<Matrix3d>& reference,
                   bool fit_axes, std::optional<double> heading = {}) {
  Comparison out;
  if (heading) out.heading = *heading;
  for (int i = 0; i < 50; ++i) {
    if (fit_axes) {
      Matrix3d M = Matrix3d::Zero();
      for (std::size_t k = 0; k < ours.size(); ++k) {
        M += ours[k].transpose() * about_z(out.heading) * reference[k];
      }
      out.axes = nearest_rotation(M);
    }
    if (heading) break;
    Matrix3d M = Matrix3d::Zero();
    for (std::size_t k = 0; k < ours.size(); ++k) {
      M += ours[k] * out.axes * reference[k].transpose();
    }
    out.heading = std::atan2(M(1, 0) - M(0, 1), M(0, 0) + M(1, 1));
  }
  for (std::size_t k = 0; k < ours.size(); ++k) {
    const Matrix3d A = ours[k] * out.axes, B = about_z(out.heading) * reference[k];
    const double angle = std::abs(Eigen::AngleAxisd(A.transpose() * B).angle());
    out.rmse += angle * angle;
    out.worst = std::max(out.worst, angle);
    const double tilt = std::acos(std::clamp(A.row(2).dot(B.row(2)), -1.0, 1.0));
    out.tilt += tilt * tilt;
  }
  out.rmse = std::sqrt(out.rmse / static_cast<double>(ours.size()));
  out.tilt = std::sqrt(out.tilt / static_cast<double>(ours.size()));
  return out;
}

// -------------------------------------------------------------------------------------------------
// gaitmap: raw inertial sensors on two feet, next to optical markers on the shoes.

std::vector<std::vector<double>> numbers(const fs::path& file, std::size_t header_rows) {
  std::vector<std::vector<double>> rows;
  std::ifstream in(file);
  std::string line, cell;
  for (std::size_t i = 0; std::getline(in, line); ++i) {
    if (i < header_rows) continue;
    std::vector<double> row;
    std::istringstream cells(line);
    while (std::getline(cells, cell, ',')) row.push_back(cell.empty() ? NAN : std::stod(cell));
    rows.push_back(std::move(row));
  }
  return rows;
}

// A shoe is one rigid body by itself: the filter's root, without any limb. Heels strike within
// milliseconds, so its jerk is large and no reading is too odd to be true; there is no soft tissue.
// Found by trial on these very recordings.
FilterSettings shoe() {
  FilterSettings s;
  s.root_turn_jerk = 30e3;
  s.root_jerk = 1e3;
  s.gyro_noise = 0.01;
  s.accel_noise = 0.2;
  s.arm_sigma = 0.0;
  s.mount_sigma = s.mount_tilt = 1e-4;
  s.mount_walk = 0.0;
  s.gate = 1.0 - 1e-11;
  s.limits = false;
  return s;
}

void Bench::one_foot(std::size_t which, const char* name) {
  CsvMapping mapping = CsvMapping::load(repository / "garments/csv/gaitmap.toml");
  // Its board alone, on the root segment; the segment's origin is the sensor.
  mapping.boards = {mapping.boards[which]};
  mapping.garment.boards = {mapping.garment.boards[which]};
  mapping.garment.boards[0].segment = Joint::kPelvis;
  CsvStream stream(data / "imu/gaitmap/imu_sample.csv", mapping);
  const Garment& garment = stream.garment();

  StartSettings settings;
  settings.mountings = {std::nullopt};
  settings.movement = 10.0;
  Starter starter(garment, settings);
  Measurement m;
  while (stream.next(m) == Next::kPose && starter.add(m) != Starter::Stage::kDone) {
  }
  StartResult start = starter.finish();
  start.X_BS[0].translation().setZero();
  start.pose.p_WR.setZero();
  BodyFilter filter(start.skeleton, garment, start.X_BS, shoe());
  filter.start(start.pose, start.stamp_ns, start.biases);
  ContactSettings standing;
  standing.velocity = 0.02;
  standing.every = 0.02;
  standing.height = 0.01;
  standing.floor = true;  // the walk is on a level floor
  FootContacts contacts({{0, index(Joint::kPelvis), Vector3d::Zero(), 0.0}}, standing);

  std::vector<double> times;
  std::vector<Matrix3d> R_WB;
  std::vector<Vector3d> p_W, rates;
  (void)stream.rewind();
  while (stream.next(m) == Next::kPose) {
    if (m.stamp_ns <= start.stamp_ns) continue;
    filter.process(m);
    contacts.update(m, filter);
    times.push_back(1e-9 * static_cast<double>(m.stamp_ns));
    R_WB.push_back(filter.pose().q_PB[0].toRotationMatrix());
    p_W.push_back(filter.pose().p_WR);
    rates.push_back(filter.joint_rate(Joint::kPelvis));
  }

  // Columns: L_TOE R_TOE L_FCC R_FCC R_FM5 L_FM5, three each after the row number [mm].
  const auto markers = numbers(data / "imu/gaitmap/mocap_sample.csv", 2);
  const std::size_t toe = which == 0 ? 1 : 4, heel = which == 0 ? 7 : 10,
                    fm5 = which == 0 ? 16 : 13;
  const auto marker = [&](double time, std::size_t column) {
    const double at = std::clamp(100.0 * time, 0.0, static_cast<double>(markers.size()) - 1.001);
    const auto i = static_cast<std::size_t>(at);
    const double u = at - static_cast<double>(i);
    Vector3d p;
    for (std::size_t k = 0; k < 3; ++k) {
      p[static_cast<Eigen::Index>(k)] =
          1e-3 * ((1.0 - u) * markers[i][column + k] + u * markers[i + 1][column + k]);
    }
    return p;
  };
  const double end = static_cast<double>(markers.size() - 2) / 100.0;
  std::vector<Matrix3d> ours, reference;
  double rate_squares = 0.0, rate_size = 0.0, samples = 0.0;
  for (std::size_t k = 0; k < times.size() && times[k] < end; ++k) {
    const Vector3d x = (marker(times[k], toe) - marker(times[k], heel)).normalized();
    Vector3d z = x.cross(marker(times[k], fm5) - marker(times[k], heel)).normalized();
    if (which == 1) z = -z;  // the fifth toe is on the other side
    z = -z;
    Matrix3d R;
    R << x, z.cross(x), z;
    ours.push_back(R_WB[k]);
    reference.push_back(R);
  }
  const Comparison fit = compare(ours, reference, true);
  // Rates: the marker frame's, over 20 ms, in our axes.
  for (std::size_t k = 2; k + 2 < reference.size(); ++k) {
    const Matrix3d turn = reference[k - 2].transpose() * reference[k + 2];
    const Eigen::AngleAxisd a(turn);
    const Vector3d w = fit.axes * (a.angle() * a.axis()) / (times[k + 2] - times[k - 2]);
    rate_squares += (w - rates[k]).squaredNorm();
    rate_size += w.squaredNorm();
    samples += 1.0;
  }
  // Strides, from one rest of the foot to the next, over the ground.
  std::ifstream in(data / "imu/gaitmap/stride_events_sample.csv");
  std::string line;
  std::getline(in, line);
  double absolute = 0.0, signed_sum = 0.0, length = 0.0, strides = 0.0, height = 0.0;
  while (std::getline(in, line)) {
    if (line.find(which == 0 ? ",left," : ",right,") == std::string::npos) continue;
    std::vector<std::string> cells;
    std::istringstream stream_of(line);
    for (std::string cell; std::getline(stream_of, cell, ',');) cells.push_back(cell);
    // Events are where the foot is slowest; a little later it still stands, and that is known.
    constexpr double kKnown = 0.08;
    const double from = std::stod(cells[2]) / 204.8 + kKnown;
    const double to = std::stod(cells[3]) / 204.8 + kKnown;
    const auto at = [&](double time) {
      const auto i = std::lower_bound(times.begin(), times.end(), time) - times.begin();
      return p_W[std::min(p_W.size() - 1, static_cast<std::size_t>(i))];
    };
    if (from < times.front() || to > end) continue;
    const Vector3d truth = marker(to, heel) - marker(from, heel), mine = at(to) - at(from);
    const double error = mine.head<2>().norm() - truth.head<2>().norm();
    absolute += std::abs(error);
    signed_sum += error;
    length += truth.head<2>().norm();
    height += std::abs(mine.z() - truth.z());
    strides += 1.0;
  }
  const Vector3d there_and_back = p_W.back() - p_W.front();
  const Vector3d truly = about_z(fit.heading) * (marker(end, heel) - marker(times.front(), heel));
  const double rate_rmse = std::sqrt(rate_squares / samples);
  fmt::print(
      table,
      "gaitmap {:5}: orientation {:.1f} deg RMSE ({:.1f} at most, tilt {:.1f}), rate {:.0f} "
      "deg/s RMSE of {:.0f}; {:.0f} strides of {:.2f} m: {:.1f} cm off ({:+.1f} mean), height "
      "{:.1f} cm; end of the walk {:.2f} m off after {:.0f} m; {} contacts\n",
      name, deg(fit.rmse), deg(fit.worst), deg(fit.tilt), deg(rate_rmse),
      deg(std::sqrt(rate_size / samples)), strides, length / strides, 100.0 * absolute / strides,
      100.0 * signed_sum / strides, 100.0 * height / strides,
      (there_and_back - truly).head<2>().norm(), length, contacts.counts().contacts);
  report["gaitmap"].push_back({{"foot", name},
                               {"orientation_rmse_deg", deg(fit.rmse)},
                               {"tilt_rmse_deg", deg(fit.tilt)},
                               {"rate_rmse_deg_s", deg(rate_rmse)},
                               {"strides", strides},
                               {"stride_m", length / strides},
                               {"stride_error_m", absolute / strides},
                               {"stride_bias_m", signed_sum / strides},
                               {"end_error_m", (there_and_back - truly).head<2>().norm()}});
}

void Bench::feet() {
  if (!fs::exists(data / "imu/gaitmap/imu_sample.csv")) {
    fmt::print(table, "gaitmap: absent\n");
    return;
  }
  one_foot(0, "left");
  one_foot(1, "right");
}

// -------------------------------------------------------------------------------------------------
// qmt: upper back and right arm, next to the suit's own segment orientations.

void Bench::arm() {
  const fs::path file = data / "imu/qmt/right_arm_first30s.csv.gz";
  if (!fs::exists(file)) {
    fmt::print(table, "qmt: absent\n");
    return;
  }
  const CsvMapping mapping = CsvMapping::load(repository / "garments/csv/qmt_right_arm.toml");
  WearableOptions options;
  for (const CsvBoard& board : mapping.boards) options.start.mountings.push_back(board.q_BS);
  options.start.movement = 12.0;
  WearableSource source(std::make_unique<CsvStream>(file, mapping),
                        CsvStream(file, mapping).garment(), options);
  for (const auto& warning : source.start().warnings) fmt::print(table, "qmt: {}\n", warning);
  // The suit's segments have x to the front, y up, z to the right.
  Matrix3d axes;
  axes << 1, 0, 0, 0, 0, 1, 0, -1, 0;  // from ours to the suit's
  constexpr std::array kSegments{Joint::kSpineUpper, Joint::kRightShoulder, Joint::kRightElbow,
                                 Joint::kRightWrist};
  CsvStream suit(file, mapping);
  Measurement m;
  StampedPose pose;
  std::array<std::vector<Matrix3d>, 4> ours, reference;
  std::vector<Eigen::Isometry3d> X_WB(kJointCount);
  bool more = suit.next(m) == Next::kPose;
  while (source.next(pose) == Next::kPose) {
    while (more && m.stamp_ns < pose.stamp_ns) more = suit.next(m) == Next::kPose;
    if (!more || m.stamp_ns != pose.stamp_ns) continue;
    forward_kinematics(source.skeleton(), pose.pose.p_WR, pose.pose.q_PB, X_WB);
    for (std::size_t s = 0; s < kSegments.size(); ++s) {
      if (!suit.orientations()[s]) continue;
      ours[s].push_back(X_WB[index(kSegments[s])].linear());
      reference[s].push_back(suit.orientations()[s]->toRotationMatrix() * axes);
    }
  }
  // Each segment once as it is but for one heading, which its upper back tells, and once with the
  // axes' conventions taken out.
  const double heading = compare(ours[0], reference[0], true).heading;
  for (std::size_t s = 0; s < kSegments.size(); ++s) {
    const auto as_is =
        compare(ours[s], reference[s], false, compare(ours[0], reference[0], false).heading);
    const auto shared = compare(ours[s], reference[s], true, heading);
    const auto own = compare(ours[s], reference[s], true);
    double squares = 0.0, size = 0.0, n = 0.0;
    for (std::size_t k = 2; k + 2 < ours[s].size(); ++k) {
      const auto rate = [&](const std::vector<Matrix3d>& R) {
        const Eigen::AngleAxisd a(R[k - 2].transpose() * R[k + 2]);
        return Vector3d(a.angle() * a.axis() / 0.04);
      };
      const Vector3d w = own.axes * rate(reference[s]);
      squares += (rate(ours[s]) - w).squaredNorm();
      size += w.squaredNorm();
      n += 1.0;
    }
    fmt::print(
        table,
        "qmt {:16}: {:5.1f} deg RMSE once axes agree ({:.1f} with the back's heading, {:.1f} "
        "at most), tilt {:.1f}; {:.1f} as started, mountings as in the mapping; rate {:.0f} "
        "of {:.0f} deg/s\n",
        mapping.garment.boards[s].name, deg(own.rmse), deg(shared.rmse), deg(own.worst),
        deg(own.tilt), deg(as_is.rmse), deg(std::sqrt(squares / n)), deg(std::sqrt(size / n)));
    report["qmt"].push_back({{"segment", mapping.garment.boards[s].name},
                             {"rmse_deg", deg(own.rmse)},
                             {"shared_heading_rmse_deg", deg(shared.rmse)},
                             {"tilt_rmse_deg", deg(own.tilt)},
                             {"as_started_rmse_deg", deg(as_is.rmse)},
                             {"rate_rmse_deg_s", deg(std::sqrt(squares / n))}});
  }
}

}  // namespace

int main(int argc, char** argv) {
  Bench bench;
  bench.data = bench.repository / ".." / "shared" / "data";
  CLI::App app{"Root drift and real inertial recordings through the wearable filter"};
  bool as_json = false;
  std::string only;
  app.add_option("--data", bench.data, "the recordings that are not shipped");
  app.add_option("--seconds", bench.seconds, "of each walk");
  app.add_option("--seeds", bench.seeds, "of each walk");
  app.add_option("--only", only, "root, smoother, gaitmap or qmt")
      ->check(CLI::IsMember({"root", "smoother", "gaitmap", "qmt"}));
  app.add_flag("--json", as_json, "JSON on stdout, the table on stderr");
  CLI11_PARSE(app, argc, argv);
  if (as_json) table = stderr;
  try {
    if (only.empty() || only == "gaitmap") bench.feet();
    if (only.empty() || only == "qmt") bench.arm();
    if (only.empty() || only == "root") bench.root();
    if (only.empty() || only == "smoother") bench.smoothing();
    fmt::print(table, "OpenSenseRT next to optical capture: 4.4 deg (legs), 5.6 deg (arms) RMSE\n");
    if (as_json) fmt::print("{}\n", bench.report.dump(2));
  } catch (const std::exception& error) {
    fmt::print(stderr, "wearable_real_bench: {}\n", error.what());
    return 1;
  }
}
