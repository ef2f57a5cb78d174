#include "server/wearable/signal/slot_source.h"

#include <fmt/format.h>
#include <poll.h>

#include <charconv>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <vector>

#include "wire/serial_port.h"
#include "wire/tcp_client.h"

namespace secondskin::server {
namespace {

namespace fs = std::filesystem;

constexpr double kSilenceTold = 0.25;  // [s]
constexpr int kWaitMs = 5;
// More than one block of eighteen boards, so that a file is read in few calls.
constexpr std::size_t kChunk = 1 << 16;

double monotonic() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// "127.0.0.1:7000"
std::unique_ptr<wire::TcpClient> tcp_of(const std::string& place) {
  const auto colon = place.rfind(':');
  if (colon == std::string::npos || place.find('/') != std::string::npos) return nullptr;
  unsigned port = 0;
  const char* end = place.data() + place.size();
  const auto parsed = std::from_chars(place.data() + colon + 1, end, port);
  if (parsed.ec != std::errc{} || parsed.ptr != end) return nullptr;
  if (!place.starts_with("127.")) {
    throw std::runtime_error(fmt::format(
        "'{}' is another machine: expected an address of this one, such as 127.0.0.1:7000", place));
  }
  return std::make_unique<wire::TcpClient>(place.substr(0, colon), port);
}

}  // namespace

struct SlotSource::State {
  std::string place;
  std::ifstream file;
  std::unique_ptr<wire::SerialPort> port;
  std::unique_ptr<wire::TcpClient> socket;
  std::uint64_t openings = 0;
  bool ended = false;
  wire::GarmentStreamReader reader;
  std::vector<std::uint8_t> buffer = std::vector<std::uint8_t>(kChunk);
  // Slots that one read completed: reused, and given out one by one.
  std::vector<wire::GarmentSlot> slots;
  std::size_t count = 0, given = 0;
  wire::GarmentStreamReader::Sink sink;

  bool live() const { return port || socket; }

  void take(const wire::GarmentSlot& slot) {
    if (count == slots.size()) slots.emplace_back();
    slots[count++] = slot;
  }

  bool give(const wire::GarmentSlot*& slot) {
    if (given == count) return false;
    slot = &slots[given++];
    return true;
  }

  // @returns whether anything came
  bool read_live() {
    const bool there = port ? port->poll(monotonic()) : socket->poll(monotonic());
    if (!there) return false;
    const auto now_open = port ? port->openings() : socket->openings();
    if (now_open != openings) {
      if (openings != 0) reader.reset();
      openings = now_open;
    }
    wire::ByteLink& link = port ? static_cast<wire::ByteLink&>(*port) : *socket;
    const std::size_t got = link.read_some(buffer);
    if (got > 0) reader.feed({buffer.data(), got}, sink);
    return got > 0;
  }

  void wait() {
    pollfd events{port ? port->fd() : socket->fd(), POLLIN, 0};
    ::poll(&events, events.fd >= 0 ? 1 : 0, kWaitMs);
  }
};

SlotSource::SlotSource(const std::string& place) : state_(std::make_unique<State>()) {
  State& s = *state_;
  s.place = place;
  s.sink = [&s](const wire::GarmentSlot& slot) { s.take(slot); };
  if (fs::is_regular_file(place)) {
    s.file.open(place, std::ios::binary);
    if (!s.file) throw std::runtime_error(fmt::format("'{}' cannot be read", place));
  } else if (auto socket = tcp_of(place)) {
    s.socket = std::move(socket);
  } else if (fs::is_character_file(place) || place.starts_with("/dev/")) {
    s.port = std::make_unique<wire::SerialPort>(place);
  } else {
    throw std::runtime_error(fmt::format(
        "'{}' is no garment: expected a .garment file, a port such as /dev/ttyACM0, or a socket "
        "such as 127.0.0.1:7000",
        place));
  }
}

SlotSource::~SlotSource() = default;

bool SlotSource::live() const noexcept { return state_->live(); }
const std::string& SlotSource::place() const noexcept { return state_->place; }

Next SlotSource::next(const wire::GarmentSlot*& slot) {
  State& s = *state_;
  if (s.give(slot)) return Next::kPose;
  s.count = s.given = 0;
  if (s.live()) {
    const double end = monotonic() + kSilenceTold;
    while (monotonic() < end) {
      const bool came = s.read_live();
      if (s.give(slot)) return Next::kPose;
      if (!came) s.wait();
    }
    return Next::kSilence;
  }
  while (!s.ended) {
    s.file.read(reinterpret_cast<char*>(s.buffer.data()),
                static_cast<std::streamsize>(s.buffer.size()));
    const auto got = static_cast<std::size_t>(s.file.gcount());
    s.reader.feed({s.buffer.data(), got}, s.sink);
    if (got == 0) {
      s.reader.finish(s.sink);
      s.ended = true;
      if (!s.reader.header()) {
        throw std::runtime_error(
            fmt::format("'{}' is no garment file: expected a header with 'GARMENT'", s.place));
      }
    }
    if (s.give(slot)) return Next::kPose;
  }
  return Next::kEnd;
}

bool SlotSource::rewind() {
  State& s = *state_;
  if (s.live()) return false;
  s.file.clear();
  s.file.seekg(0);
  s.reader = {};
  s.count = s.given = 0;
  s.ended = false;
  return true;
}

const std::optional<wire::GarmentStreamHeader>& SlotSource::header() const noexcept {
  return state_->reader.header();
}
const wire::GarmentStreamCounters& SlotSource::counters() const noexcept {
  return state_->reader.counters();
}
bool SlotSource::connected() const noexcept {
  const State& s = *state_;
  return s.port ? s.port->connected() : s.socket ? s.socket->connected() : s.file.is_open();
}
std::string SlotSource::trouble() const {
  const State& s = *state_;
  return s.port ? s.port->last_error() : s.socket ? s.socket->last_error() : std::string();
}

void check_stream(const wire::GarmentStreamHeader& header, const Garment& garment,
                  const std::string& place) {
  const auto check = [&](const char* field, double got, double expected) {
    if (std::abs(got - expected) <= 1e-3) return;
    throw std::runtime_error(fmt::format("{}: the stream's {} is {}, garment '{}' has {}", place,
                                         field, got, garment.name, expected));
  };
  check("number of boards", header.boards, static_cast<double>(garment.boards.size()));
  check("number of sources", header.sources, static_cast<double>(garment.sources.size()));
  check("number of samples a slot", header.slot_samples, static_cast<double>(garment.slot_samples));
  check("sampling rate", header.sample_rate_hz, garment.sample_rate_hz);
  check("inertial rate", header.inertial_rate_hz, garment.inertial_rate_hz);
  check("carrier", header.carrier_hz, garment.carrier_hz);
  if (header.garment != garment.name) {
    throw std::runtime_error(fmt::format("{}: the stream is of garment '{}', expected '{}'", place,
                                         header.garment, garment.name));
  }
}

}  // namespace secondskin::server
