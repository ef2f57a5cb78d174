#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "motion/markers.h"
#include "motion/retarget.h"
#include "motion/suit.h"
#include "server/optical/optical_source.h"
#include "server/pose_source.h"
#include "server/wearable/wearable_source.h"

namespace secondskin::server {

/// What belongs to an installation of the optical system and to who wears the suit.
struct OpticalSettings {
  std::filesystem::path suit;        ///< which detectors there are (motion/suit.h)
  std::filesystem::path projectors;  ///< their calibration (projector.h)
  std::filesystem::path body;  ///< the wearer's (markers/body_file.h); may be empty for files,
                               ///< which then calibrate themselves
  bool gray = false;           ///< the tags send the Gray code as it is read
};

/// What belongs to a garment and to who wears it.
struct WearableSettings {
  std::filesystem::path garment;  ///< motion/garment.h; for a table its mapping (csv_mapping.h), or
                                  ///< empty: the .toml beside it
  std::filesystem::path calibration;  ///< wearable_calibration.h; empty: nominal
  WearableOptions options;
  std::optional<double> temperature;  ///< of the air; empty: as the stream says [deg C]
};

/// What a source may need beside its name.
struct SourceSettings {
  std::filesystem::path joint_maps, marker_sets;  ///< folders
  RetargetOptions retarget;
  OpticalSettings optical;
  WearableSettings wearable;
};

/// Opens what a user names as a SOURCE: "replay:FILE" or just FILE (.bvh, .mcap, .c3d, .trc,
/// UI-PRMD .txt and .txt.gz), "optical:PORT,PORT…" or "optical:FILE,FILE…", a port or file a tag;
/// "wearable:FILE.garment", "wearable:PORT", "wearable:tcp:ADDRESS:PORT" or "wearable:FILE.csv";
/// "mvn:PORT" (on 127.0.0.1) or "mvn:ADDRESS:PORT": where Xsens MVN sends its datagrams to.
/// @throws std::runtime_error naming the source, and the kinds that there are when it is none.
std::unique_ptr<PoseSource> open_source(const std::string& source, const SourceSettings& settings);

/// The places of an "optical:" source. @throws std::runtime_error when it is none.
std::vector<std::string> optical_places(const std::string& source);

/// The points of a stretch of an optical stream, for the calibration of a body: until `seconds`
/// have passed or the files end. @param look  told the time so far [s] and the newest points;
/// returning false ends it
MarkerMotion record_points(OpticalReceiver& receiver, const ProjectorRig& rig, const Suit& suit,
                           double seconds,
                           const std::function<bool(double, const MarkerFrame&)>& look = {});

/// The bytes to expect of a suit's tags.
OpticalFormat format_of(const Suit& suit, std::size_t projectors, bool gray);

/// Gives `look` every pose until the source ends.
template <class Look>
void for_each_pose(PoseSource& source, Look look) {
  StampedPose pose;
  for (Next next = source.next(pose); next != Next::kEnd; next = source.next(pose)) {
    if (next == Next::kPose) look(pose);
  }
}

/// All poses of a source as a motion, as fast as it yields them. Recordings with uneven stamps are
/// resampled at their nominal rate. Invalid poses are left out.
Motion read_all(PoseSource& source);

}  // namespace secondskin::server
