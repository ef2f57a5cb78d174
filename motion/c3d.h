#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <stdexcept>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "motion/markers.h"

/// C3D files (c3d.org) of all six kinds: Intel, DEC and SGI byte orders, integer and real storage.
///
/// A file's points are split by what its POINT group says of them: those listed in POINT:ANGLES,
/// FORCES, MOMENTS, POWERS, SCALARS or REACTIONS are results that some program derived, all others
/// are markers. Axes stay as they are in the file; marker_file.h turns them z up.
namespace secondskin {

/// Whose numbers the file holds; the value is the file's own code.
enum class C3dProcessor : std::uint8_t { kIntel = 84, kDec = 85, kSgi = 86 };
enum class C3dStorage : std::uint8_t { kInteger, kReal };

/// A parameter as the file has it.
struct C3dParameter {
  using Values = std::variant<std::string, std::vector<std::int8_t>, std::vector<std::int16_t>,
                              std::vector<float>>;

  std::string name{};
  std::string description{};
  bool locked = false;
  /// At most 7; the first varies fastest and is the length of each string in text. None: one value.
  std::vector<std::uint8_t> dimensions{};
  Values values{};  ///< as many as the product of the dimensions; text in one piece

  /// Text cut into its strings, blanks behind each removed; empty for numbers.
  std::vector<std::string> strings() const;
  /// The numbers; empty for text.
  std::vector<double> numbers() const;
};

struct C3dGroup {
  std::string name{};
  std::string description{};
  bool locked = false;
  std::vector<C3dParameter> parameters{};
};

enum class C3dKind : std::uint8_t { kAngle, kForce, kMoment, kPower, kScalar, kReaction };

/// A result over time that the file stores as a point, such as a joint angle.
struct C3dDerived {
  std::string name{};
  std::string description{};
  C3dKind kind = C3dKind::kAngle;
  std::string unit{};                     ///< as the file says, e.g. "deg"
  std::vector<Eigen::Vector3d> values{};  ///< one a frame, in `unit`
  std::vector<std::uint8_t> valid{};      ///< one a frame; 1 where there is a value
};

/// An analog channel. Its samples are stored as value / scale + offset.
struct C3dAnalog {
  std::string name{};
  std::string description{};
  std::string unit{};
  double scale = 1.0;  ///< general scale included
  double offset = 0.0;
  std::vector<double> values{};  ///< in `unit`; the same whole number a frame in every channel
};

struct C3dEvent {
  std::string label{};    ///< e.g. "Foot Strike"
  std::string context{};  ///< e.g. "Left"; may be empty
  double time = 0.0;      ///< [s]; frame f of the file is at (f − 1) / rate
};

struct C3dFile {
  MarkerMotion markers;                          ///< metres, the file's axes
  std::vector<std::string> marker_descriptions;  ///< one per marker; none where all are blank
  std::vector<C3dDerived> derived;
  std::vector<C3dAnalog> analog;
  std::vector<C3dEvent> events;
  std::size_t first_frame = 1;                    ///< number of the first frame
  std::vector<C3dGroup> groups;                   ///< every parameter, as read
  C3dProcessor processor = C3dProcessor::kIntel;  ///< as read
  C3dStorage storage = C3dStorage::kReal;         ///< as read

  /// Capitals do not matter. Null where there is none.
  const C3dParameter* find(std::string_view group, std::string_view name) const noexcept;
  /// Replaces the parameter of that name, or adds it and its group.
  void set(std::string_view group, C3dParameter parameter);
};

/// What is wrong with a file and where: "FILE: byte N: found X, expected Y" or
/// "FILE: GROUP:PARAMETER: found X, expected Y".
class C3dError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A point is not visible where its fourth word is negative, a coordinate is no number, or, for
/// markers, all three are exactly 0. Points without a label are called "*N", N counting from 1;
/// a label that an earlier point has gets "_2", "_3", …
/// @throws C3dError on anything but a whole file; never takes more memory than the file warrants.
C3dFile read_c3d(const std::filesystem::path& file);
C3dFile read_c3d(std::istream& in, std::string_view name);

/// Writes markers, derived points, analog channels, events and first frame, in the unit of
/// POINT:UNITS (mm where there is none). Parameters that these determine (counts, rates, labels,
/// scales, pointers) are written anew; all others as they are. Camera masks are not kept.
/// Integer storage keeps POINT:SCALE and a channel's scale where all values are whole steps of it,
/// else the largest value becomes 32000 steps; markers and derived points share one scale, so that
/// moments of 1e5 Nmm leave markers steps of 3 mm.
/// The file appears whole or not at all.
/// @throws C3dError where the format cannot hold the content, std::system_error where the file
/// cannot be written.
void write_c3d(const C3dFile& content, const std::filesystem::path& file, C3dProcessor processor,
               C3dStorage storage);
void write_c3d(const C3dFile& content, std::ostream& out, C3dProcessor processor,
               C3dStorage storage);

}  // namespace secondskin
