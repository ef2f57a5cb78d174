#include "server/open_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "motion/marker_file.h"
#include "server/markers/body_file.h"
#include "server/markers/marker_source.h"
#include "server/mvn/mvn_source.h"
#include "server/replay/motion_source.h"
#include "server/replay/recording_source.h"
#include "server/wearable/csv/csv_stream.h"
#include "server/wearable/signal/garment_receiver.h"

namespace secondskin::server {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kReplay = "replay:";
constexpr std::string_view kOptical = "optical:";
constexpr std::string_view kWearable = "wearable:";
constexpr std::string_view kMvn = "mvn:";
constexpr const char* kKinds =
    "expected replay:FILE or FILE (.bvh, .mcap, .c3d, .trc, UI-PRMD .txt or .txt.gz), "
    "optical:PORT,PORT... or optical:FILE,FILE..., wearable:FILE.garment, wearable:PORT, "
    "wearable:tcp:ADDRESS:PORT or wearable:FILE.csv, or mvn:PORT or mvn:ADDRESS:PORT";

std::unique_ptr<PoseSource> open_optical(const std::string& source,
                                         const OpticalSettings& settings) {
  const Suit suit = Suit::load(settings.suit);
  const ProjectorRig rig = ProjectorRig::load(settings.projectors);
  const auto places = optical_places(source);
  const auto format = format_of(suit, rig.size(), settings.gray);
  auto receiver = std::make_unique<OpticalReceiver>(places, format);
  if (!settings.body.empty()) {
    return std::make_unique<OpticalSource>(std::move(receiver), rig, suit,
                                           load_body(settings.body));
  }
  if (receiver->live()) {
    throw std::runtime_error(fmt::format(
        "source '{}': the wearer's body is not known; measure it with 'secondskin calibrate "
        "skeleton {}' and name it with --body",
        source, source));
  }
  // A recording is at hand as a whole: its own movement tells the body.
  const MarkerMotion points =
      record_points(*receiver, rig, suit, std::numeric_limits<double>::infinity());
  if (points.frames.empty())
    throw std::runtime_error(fmt::format("source '{}': no set of bytes in it", source));
  const auto set = MarkerSet::from_suit(suit, canonical_skeleton());
  auto body = calibrate_body(set, points).body;
  return std::make_unique<OpticalSource>(std::make_unique<OpticalReceiver>(places, format), rig,
                                         suit, body);
}

// A table's boards mostly sit as they may: then a few movements tell how.
constexpr double kMovement = 12.0;  // [s]

std::unique_ptr<PoseSource> open_table(const fs::path& table, const WearableSettings& settings) {
  const fs::path file = settings.garment.empty() ? mapping_beside(table) : settings.garment;
  if (!fs::exists(file)) {
    throw std::runtime_error(
        fmt::format("{}: which column is which? expected a mapping in {}, or named with --garment",
                    table.string(), file.string()));
  }
  auto stream = std::make_unique<CsvStream>(table, CsvMapping::load(file));
  WearableOptions options = settings.options;
  options.start.mountings.clear();
  bool known = true;
  for (const CsvBoard& board : stream->mapping().boards) {
    options.start.mountings.push_back(board.q_BS);
    known = known && board.q_BS.has_value();
  }
  if (!known && options.start.movement == 0.0) options.start.movement = kMovement;
  Garment garment = stream->garment();
  return std::make_unique<WearableSource>(std::move(stream), std::move(garment), options);
}

std::unique_ptr<PoseSource> open_wearable(const std::string& source,
                                          const WearableSettings& settings) {
  constexpr std::string_view kTcp = "tcp:";
  std::string place = source.substr(kWearable.size());
  if (place.starts_with(kTcp)) place.erase(0, kTcp.size());
  if (place.empty()) {
    throw std::runtime_error(fmt::format("source '{}': no place named; {}", source, kKinds));
  }
  try {
    if (place.ends_with(".csv") || place.ends_with(".csv.gz")) return open_table(place, settings);
    const Garment garment = Garment::load(settings.garment);
    const auto calibration = settings.calibration.empty()
                                 ? WearableCalibration::nominal(garment)
                                 : WearableCalibration::load(settings.calibration, garment);
    return std::make_unique<WearableSource>(
        std::make_unique<GarmentReceiver>(place, garment, calibration, settings.temperature),
        garment, settings.options);
  } catch (const std::exception& error) {
    throw std::runtime_error(fmt::format("source '{}': {}", source, error.what()));
  }
}

std::unique_ptr<PoseSource> open_mvn(const std::string& source, const RetargetOptions& options) {
  try {
    const auto place = wire::UdpPlace::parse(std::string_view(source).substr(kMvn.size()));
    return std::make_unique<MvnSource>(place, options);
  } catch (const std::exception& error) {
    throw std::runtime_error(fmt::format("source '{}': {}", source, error.what()));
  }
}

}  // namespace

std::vector<std::string> optical_places(const std::string& source) {
  std::vector<std::string> places;
  if (source.starts_with(kOptical)) {
    std::size_t begin = kOptical.size();
    while (begin <= source.size()) {
      const std::size_t end = std::min(source.find(',', begin), source.size());
      places.push_back(source.substr(begin, end - begin));
      begin = end + 1;
    }
  }
  const bool empty =
      std::any_of(places.begin(), places.end(), [](const auto& p) { return p.empty(); });
  if (places.empty() || empty) {
    throw std::runtime_error(
        fmt::format("source '{}': expected optical:PORT,PORT... or optical:FILE,FILE...", source));
  }
  return places;
}

OpticalFormat format_of(const Suit& suit, std::size_t projectors, bool gray) {
  OpticalFormat format{{}, projectors, gray};
  for (std::size_t tag = 0; tag < suit.tags(); ++tag) {
    format.detectors.push_back(suit.detectors_of(tag));
  }
  return format;
}

MarkerMotion record_points(OpticalReceiver& receiver, const ProjectorRig& rig, const Suit& suit,
                           double seconds,
                           const std::function<bool(double, const MarkerFrame&)>& look) {
  const double period = 1e-9 * static_cast<double>(wire::cycle_ns(rig.size()));
  MarkerMotion points;
  points.rate_hz = 1.0 / period;
  for (const auto& detector : suit.detectors) points.names.push_back(detector.name);
  BodyTracker tracker(rig, segments_of(suit));
  ProjectorFrame frame;
  MarkerFrame seen(suit.detectors.size());
  std::optional<std::uint64_t> first;
  for (Next next = receiver.next(frame); next != Next::kEnd; next = receiver.next(frame)) {
    if (next == Next::kPose) {
      if (!first) first = frame.cycle;
      tracker.update(frame, seen);
      // Cycles that were lost are frames in which nothing was seen: time stays even.
      const auto at = static_cast<std::size_t>(frame.cycle - *first);
      if (static_cast<double>(at) * period >= seconds) break;
      while (points.frames.size() < at) points.frames.emplace_back(suit.detectors.size());
      points.frames.push_back(seen);
    }
    if (look && !look(static_cast<double>(points.frames.size()) * period, seen)) break;
  }
  return points;
}

std::unique_ptr<PoseSource> open_source(const std::string& source, const SourceSettings& settings) {
  if (source.starts_with(kOptical)) return open_optical(source, settings.optical);
  if (source.starts_with(kWearable)) return open_wearable(source, settings.wearable);
  if (source.starts_with(kMvn)) return open_mvn(source, settings.retarget);
  const fs::path file(source.starts_with(kReplay) ? source.substr(kReplay.size()) : source);
  if (!fs::exists(file)) {
    throw std::runtime_error(fmt::format("source '{}': no such file; {}", source, kKinds));
  }
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (extension == ".mcap") return std::make_unique<RecordingSource>(file);
  if (extension == ".bvh") {
    return std::make_unique<MotionSource>(
        read_canonical(file, settings.joint_maps, settings.retarget));
  }
  if (is_marker_file(file)) {
    MarkerMotion markers = read_markers(file, settings.retarget.up);
    const auto set = MarkerSet::choose(settings.marker_sets, markers.names);
    return std::make_unique<MarkerSource>(std::move(markers), set);
  }
  throw std::runtime_error(
      fmt::format("source '{}': files of type '{}' are not known; {}", source, extension, kKinds));
}

Motion read_all(PoseSource& source) {
  std::vector<StampedPose> poses;
  for_each_pose(source, [&poses](const StampedPose& pose) { poses.push_back(pose); });
  const bool any = std::any_of(poses.begin(), poses.end(),
                               [](const StampedPose& pose) { return pose.pose.is_valid(); });
  if (!any) throw std::runtime_error("the source holds no valid pose");
  return evenly(source.skeleton(), source.rate_hz(), poses);
}

}  // namespace secondskin::server
