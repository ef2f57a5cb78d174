// How right is the pose that the wearable filter gives, is its uncertainty honest, what do faults
// and the lack of a kind of sensor do, and what does it cost? A body that moves by a real motion
// wears a virtual garment. docs/wearable-filter.md quotes the output.

#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <set>

#include "bench/wearable_runs.h"
#include "server/wearable/estimate/covariance.h"
#include "server/wearable/estimate/symmetric_kernel.h"

namespace {

using namespace secondskin;
using namespace secondskin::bench;
using namespace secondskin::server;
namespace fs = std::filesystem;
using nlohmann::json;

struct Moments {
  double n = 0.0, sum = 0.0, squares = 0.0, most = 0.0;
  void add(double v) {
    n += 1.0;
    sum += v;
    squares += v * v;
    most = std::max(most, v);
  }
  double mean() const { return n > 0.0 ? sum / n : NAN; }
  double deviation() const {
    return n > 0.0 ? std::sqrt(std::max(0.0, squares / n - mean() * mean())) : NAN;
  }
};

double quantile(std::vector<double> v, double q) {
  if (v.empty()) return NAN;
  const auto i = static_cast<std::size_t>(q * static_cast<double>(v.size() - 1));
  std::nth_element(v.begin(), v.begin() + static_cast<std::ptrdiff_t>(i), v.end());
  return v[i];
}

// The paper's neck is the head's segment here: that is where the board sits.
constexpr std::array<Joint, 3> kJoints{Joint::kHead, Joint::kRightShoulder, Joint::kLeftHip};

struct Combination {
  const char* name;
  bool accel, gyro, distances;
  std::array<double, 3> paper_mean, paper_deviation;  // neck, right shoulder, left hip [deg]
};
constexpr std::array<Combination, 7> kTable1{{
    {"A", true, false, false, {159.7, 168.6, 184.0}, {147.7, 105.9, 146.0}},
    {"A+D", true, false, true, {74.0, 178.6, 165.5}, {125.4, 110.9, 144.5}},
    {"D", false, false, true, {120.2, 54.7, 117.4}, {93.4, 37.0, 79.2}},
    {"G", false, true, false, {25.9, 10.1, 8.3}, {15.9, 7.0, 8.0}},
    {"G+D", false, true, true, {18.4, 8.1, 9.8}, {7.4, 5.8, 5.4}},
    {"A+G", true, true, false, {9.5, 10.9, 5.6}, {3.4, 6.4, 4.0}},
    {"A+G+D", true, true, true, {5.7, 8.0, 6.6}, {2.9, 5.0, 3.8}},
}};

struct Bench {
  fs::path data, repository = SECONDSKIN_SOURCE_DIR;
  int seeds = 10;
  double seconds = 30.0;
  double movement = 0.0;  ///< of another motion before Table 1's, by which the filter learns how
                          ///< the boards sit [s]
  RunOptions run_options;
  FilterSettings settings;
  sim::WornErrors errors;
  std::vector<std::string> motions{"cmu/14_14.bvh", "cmu/13_26.bvh"};
  bool codec = false;
  std::string combination;
  json report;

  Motion motion(const std::string& name) const {
    return stretched(read_canonical(data / "bvh" / name, repository / "joint_maps"), seconds);
  }
  Garment garment() const { return Garment::load(repository / "garments" / "practical.toml"); }

  void table1();
  void speed();
  void treadmill();
  void faults();
  void honesty();
};

void Bench::speed() {
  const sim::WornGarment worn(motion(motions.front()), garment(), errors, 1);
  const RunCost cost = run(worn, settings, {}, [](const Moment&) {});
  const double factor = cost.body_seconds / cost.filter_seconds;
  const double p50 = 1e3 * quantile(cost.latency, 0.5), p99 = 1e3 * quantile(cost.latency, 0.99);
  const double most = 1e3 * quantile(cost.latency, 1.0);
  fmt::print("\nSpeed: {} boards, {} sources, {:.0f} Hz, {} kernels, one core\n",
             worn.garment().boards.size(), worn.garment().sources.size(),
             worn.garment().inertial_rate_hz, kernel_name());
  fmt::print(
      "real-time factor {:.1f}; a measurement takes {:.2f} ms (p50), {:.2f} (p99), {:.2f} "
      "(most)\n",
      factor, p50, p99, most);
  report["speed"] = {{"kernels", kernel_name()},
                     {"real_time_factor", factor},
                     {"p50_ms", p50},
                     {"p99_ms", p99},
                     {"most_ms", most}};
}

void Bench::table1() {
  fmt::print("\nTable 1: orientation under the given root, {} s, {} seeds [deg]\n", seconds, seeds);
  fmt::print("{:<8}{:>16}{:>16}{:>16}{:>8}{:>8}   {:>8}\n", "sensors", "neck", "right shoulder",
             "left hip", "mean", "worst", "paper");
  for (const Combination& c : kTable1) {
    if (!combination.empty() && combination != c.name) continue;
    std::array<Moments, 3> means, deviations;
    Moments runs;
    for (std::size_t which = 0; which < motions.size(); ++which) {
      const Motion before = motion(motions[(which + 1) % motions.size()]);
      const Motion played = preceded(motion(motions[which]), before, movement);
      for (int seed = 1; seed <= seeds; ++seed) {
        const sim::WornGarment worn(played, garment(), errors, static_cast<std::uint64_t>(seed));
        FilterSettings s = settings;
        s.use_accel = c.accel;
        s.use_gyro = c.gyro;
        s.use_distances = c.distances;
        RunOptions options = run_options;
        options.seed = static_cast<std::uint64_t>(seed);
        options.measurements.codec = codec;
        options.measurements.distances = c.distances;
        std::array<Moments, 3> error;
        run(worn, s, options, [&](const Moment& moment) {
          if (moment.time < played.duration() - seconds) return;
          for (std::size_t j = 0; j < kJoints.size(); ++j) {
            error[j].add(deg(
                error_under_root(worn.skeleton(), moment.filter.pose(), moment.truth, kJoints[j])));
          }
        });
        double sum = 0.0;
        for (std::size_t j = 0; j < kJoints.size(); ++j) {
          means[j].add(error[j].mean());
          deviations[j].add(error[j].deviation());
          sum += error[j].mean() / 3.0;
        }
        runs.add(sum);
      }
    }
    double paper = 0.0;
    for (const double v : c.paper_mean) paper += v / 3.0;
    fmt::print("{:<8}", c.name);
    json row{{"sensors", c.name},
             {"mean", runs.mean()},
             {"worst_run", runs.most},
             {"paper_mean", paper}};
    for (std::size_t j = 0; j < kJoints.size(); ++j) {
      fmt::print("{:>8.1f} ± {:>5.1f}", means[j].mean(), deviations[j].mean());
      row["joints"].push_back({{"mean", means[j].mean()},
                               {"deviation", deviations[j].mean()},
                               {"worst_run", means[j].most}});
    }
    fmt::print("{:>8.2f}{:>8.2f}   {:>8.1f}\n", runs.mean(), runs.most, paper);
    std::fflush(stdout);
    report["table1"].push_back(row);
  }
}

// Figure 7: five minutes on a treadmill, one stretch of a recorded walk again and again.
void Bench::treadmill() {
  const Motion walk = treadmill_walk(
      read_canonical(data / "bvh" / "cmu/131_01.bvh", repository / "joint_maps"), 300.0);
  fmt::print("\nTreadmill: left shoulder under the given root, mean of each minute [deg]\n");
  for (const bool distances : {false, true}) {
    const sim::WornGarment worn(walk, garment(), errors, 1);
    FilterSettings s = settings;
    s.use_distances = distances;
    RunOptions options = run_options;
    options.measurements.distances = distances;
    std::array<Moments, 5> minutes;
    run(worn, s, options, [&](const Moment& moment) {
      const auto minute = std::min<std::size_t>(4, static_cast<std::size_t>(moment.time / 60.0));
      minutes[minute].add(deg(error_under_root(worn.skeleton(), moment.filter.pose(), moment.truth,
                                               Joint::kLeftShoulder)));
    });
    fmt::print("{:<8}", distances ? "A+G+D" : "A+G");
    json row;
    for (const Moments& minute : minutes) {
      fmt::print("{:>8.1f} ± {:>4.1f}", minute.mean(), minute.deviation());
      row.push_back(minute.mean());
    }
    fmt::print("\n");
    std::fflush(stdout);
    report["treadmill"][distances ? "A+G+D" : "A+G"] = row;
  }
}

// From 10 s to 70 s of 75 s; the same wearer and the same motion each time.
void Bench::faults() {
  const Motion played =
      stretched(read_canonical(data / "bvh" / motions.front(), repository / "joint_maps"), 75.0);
  struct Fault {
    std::string name;
    std::function<void(sim::GarmentFaults&, Garment&)> make;
  };
  const auto at = [](std::size_t which) { return sim::Outage{which, 13.0, 73.0}; };
  const std::vector<Fault> cases{
      {"none", [](sim::GarmentFaults&, Garment&) {}},
      {"right upper arm's board silent",
       [&](sim::GarmentFaults& f, Garment&) { f.silent.push_back(at(12)); }},
      {"its digital stream broken",
       [&](sim::GarmentFaults& f, Garment&) { f.bit_errors.push_back(at(12)); }},
      {"hat's source blocked",
       [&](sim::GarmentFaults& f, Garment&) { f.blocked.push_back(at(7)); }},
      {"belly's three sources blocked",
       [&](sim::GarmentFaults& f, Garment&) {
         for (std::size_t i = 0; i < 3; ++i) f.blocked.push_back(at(i));
       }},
      {"air 10 K warmer than assumed",
       [](sim::GarmentFaults& f, Garment&) { f.temperature_error = 10.0; }},
      {"ranges of 250 deg/s and 2 g",
       [](sim::GarmentFaults&, Garment& g) {
         for (SensorBoard& board : g.boards) {
           board.gyro_range *= 0.5;
           board.accel_range *= 2.0 / 3.0;
         }
       }},
  };
  fmt::print("\nFaults from 10 to 70 s of 75 s: under the given root [deg]\n");
  fmt::print("{:<34}{:>8}{:>16}{:>12}{:>10}{:>10}\n", "", "neck", "right shoulder", "left hip",
             "mean", "after");
  for (const Fault& fault : cases) {
    Garment worn_garment = garment();
    RunOptions options = run_options;
    fault.make(options.measurements.faults, worn_garment);
    const sim::WornGarment worn(played, worn_garment, errors, 1);
    std::array<Moments, 3> during;
    Moments all, afterwards;
    run(worn, settings, options, [&](const Moment& moment) {
      for (std::size_t j = 0; j < kJoints.size(); ++j) {
        const double e =
            deg(error_under_root(worn.skeleton(), moment.filter.pose(), moment.truth, kJoints[j]));
        if (moment.time > 10.0 && moment.time < 70.0) {
          during[j].add(e);
          all.add(e);
        }
        if (moment.time > 72.0) afterwards.add(e);
      }
    });
    fmt::print("{:<34}{:>8.1f}{:>16.1f}{:>12.1f}{:>10.1f}{:>10.1f}\n", fault.name, during[0].mean(),
               during[1].mean(), during[2].mean(), all.mean(), afterwards.mean());
    std::fflush(stdout);
    report["faults"].push_back({{"fault", fault.name},
                                {"mean", all.mean()},
                                {"after", afterwards.mean()},
                                {"right_shoulder", during[1].mean()}});
  }
}

// How sure the filter is against how right: each joint's rotation error over its covariance, and
// innovations over theirs; 1 is honest.
void Bench::honesty() {
  fmt::print("\nHonesty on real motion: normalised squares a degree of freedom, 1 is honest\n");
  fmt::print("{:<34}{:>8}{:>8}{:>10}{:>10}\n", "", "joints", "gyro", "accel", "distance");
  for (const bool tissue : {true, false}) {
    sim::WornErrors e = errors;
    if (!tissue) e.tissue_angle = e.tissue_place = 0.0;
    const sim::WornGarment worn(motion(motions.front()), garment(), e, 1);
    Moments nees;
    InnovationFit gyro, accel, distance;
    run(worn, settings, run_options, [&](const Moment& moment) {
      const BodyFilter& filter = moment.filter;
      for (std::size_t i = 1; i < kJointCount; ++i) {
        const int group = filter.layout().group_of[i];
        if (group == BodyLayout::kNoGroup) continue;
        const int c = filter.layout().rotation(group, 0);
        Eigen::Matrix3d P;
        for (int r = 0; r < 3; ++r) {
          for (int k = 0; k < 3; ++k) P(r, k) = filter.covariance().at(c + r, c + k);
        }
        const Eigen::Vector3d error =
            rotation_vector(filter.pose().q_PB[i].conjugate() * moment.truth.q_PB[i]);
        nees.add(error.dot(P.ldlt().solve(error)) / 3.0);
      }
      gyro = filter.gyro_fit();
      accel = filter.accel_fit();
      distance = filter.distance_fit();
    });
    const auto a_row = [](const InnovationFit& fit) {
      return fit.nis / static_cast<double>(fit.rows);
    };
    fmt::print("{:<34}{:>8.2f}{:>8.3f}{:>10.3f}{:>10.3f}\n",
               tissue ? "with soft tissue" : "without soft tissue", nees.mean(), a_row(gyro),
               a_row(accel), a_row(distance));
    report["honesty"].push_back({{"tissue", tissue},
                                 {"joint_nees", nees.mean()},
                                 {"gyro_nis", a_row(gyro)},
                                 {"accel_nis", a_row(accel)},
                                 {"distance_nis", a_row(distance)}});
  }
}

}  // namespace

int main(int argc, char** argv) {
  Bench bench;
  bench.data = bench.repository / ".." / "shared" / "data";
  if (const char* from = std::getenv("SECONDSKIN_SHARED_DATA")) bench.data = from;
  CLI::App app{"The wearable filter against the truth"};
  std::vector<std::string> only;
  std::string json_file;
  FilterSettings& s = bench.settings;
  app.add_option("--data", bench.data, "folder of the shared recordings");
  app.add_option("--movement", bench.movement,
                 "Table 1: so much of the other motion comes first, not counted [s]")
      ->check(CLI::Range(0.0, 300.0));
  app.add_option("--only", only, "table1, treadmill, faults, honesty, speed; all unless given");
  app.add_option("--seeds", bench.seeds);
  app.add_option("--seconds", bench.seconds, "of motion a run");
  app.add_option("--motions", bench.motions, "below bvh/ of the data");
  app.add_option("--combination", bench.combination, "one row of Table 1");
  app.add_flag("--codec", bench.codec, "inertial readings through 6-bit delta modulation");
  app.add_option("--joint-jerk", s.joint_jerk);
  app.add_option("--chain-jerk", s.chain_jerk);
  app.add_option("--root-turn-jerk", s.root_turn_jerk);
  app.add_option("--root-jerk", s.root_jerk);
  app.add_option("--gyro-noise", s.gyro_noise);
  app.add_option("--rate-error", s.rate_error);
  app.add_option("--accel-noise", s.accel_noise);
  app.add_option("--root-sigma", bench.run_options.root_sigma_q, "of the given root [rad]");
  app.add_option("--arm-sigma", s.arm_sigma);
  app.add_option("--distance-noise", s.distance_noise);
  app.add_option("--gate", s.gate);
  app.add_option("--pose-sigma", s.pose_sigma);
  app.add_option("--mount-sigma", s.mount_sigma);
  app.add_option("--mount-tilt", s.mount_tilt);
  app.add_option("--mount-walk", s.mount_walk);
  app.add_option("--gyro-bias-walk", s.gyro_bias_walk);
  app.add_option("--accel-bias-walk", s.accel_bias_walk);
  app.add_option("--limits", s.limits);
  double tissue = 1.0, mounting = 1.0, bone = 1.0;  // shares of the default errors
  app.add_option("--tissue", tissue, "share of the soft tissue's movement, 1 by default");
  app.add_option("--mounting", mounting, "share of the mounting errors");
  app.add_option("--bone", bone, "share of the bone and source errors");
  bool perfect = false;
  app.add_flag("--perfect", perfect, "sensors and body as the filter assumes them");
  app.add_option("--json", json_file);
  CLI11_PARSE(app, argc, argv);
  sim::WornErrors& e = bench.errors;
  e.tissue_place *= tissue;
  e.tissue_angle *= tissue;
  e.mounting_place *= mounting;
  e.mounting_angle *= mounting;
  e.source_place *= bone;
  e.bone *= bone;
  if (perfect) bench.errors = sim::WornErrors::none();
  if (!fs::exists(bench.data / "bvh")) {
    fmt::print("no recordings at {}: give --data\n", bench.data.string());
    return 1;
  }
  fmt::print("kernels: {}\n", kernel_name());
  const std::set<std::string> wanted(only.begin(), only.end());
  const auto is_wanted = [&](const char* name) { return wanted.empty() || wanted.contains(name); };
  if (is_wanted("table1")) bench.table1();
  if (is_wanted("treadmill")) bench.treadmill();
  if (is_wanted("faults")) bench.faults();
  if (is_wanted("honesty")) bench.honesty();
  if (is_wanted("speed")) bench.speed();
  if (!json_file.empty()) {
    std::FILE* out = std::fopen(json_file.c_str(), "w");
    if (out == nullptr) return 1;
    fmt::print(out, "{}\n", bench.report.dump(2));
    std::fclose(out);
  }
  return 0;
}
