#include "sim/wearable/virtual_garment.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <fstream>
#include <thread>

#include "motion/retarget.h"
#include "sim/wearable/worn_garment.h"
#include "wire/pseudo_terminal.h"
#include "wire/serial_port.h"
#include "wire/tcp_listener.h"

namespace secondskin::sim {
namespace {

namespace fs = std::filesystem;

const fs::path kSource = SECONDSKIN_SOURCE_DIR;

class VirtualGarment : public ::testing::Test {
 protected:
  WornGarment worn_{
      read_canonical(kSource / "reference_motions/squat/motion.bvh", kSource / "joint_maps"),
      Garment::load(kSource / "garments/practical.toml"), WornErrors{}, 1};
  fs::path file_ = fs::temp_directory_path() /
                   ("virtual_garment_test_" + std::to_string(::getpid()) + ".garment");
  ~VirtualGarment() override { fs::remove(file_); }
};

std::vector<std::uint8_t> bytes_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

TEST_F(VirtualGarment, AFileHoldsWhatTheSignalIs) {
  GarmentSignal signal(worn_, 5);
  std::uint32_t told = 0;
  EXPECT_EQ(write_garment_file(signal, 70, file_, {}, [&](std::uint32_t slots) { told = slots; }),
            70U);
  EXPECT_EQ(told, 70U);
  GarmentSignal again(worn_, 5);
  std::vector<std::int16_t> samples(18 * 1120);
  wire::GarmentStreamReader reader;
  std::uint32_t slots = 0;
  const auto sink = [&](const wire::GarmentSlot& slot) {
    again.next(samples);
    EXPECT_EQ(slot.sequence, slots++);
    EXPECT_EQ(slot.samples, samples);
    EXPECT_EQ(slot.stamp_ns, (slots - 1) * 8'000'000LL);
  };
  reader.feed(bytes_of(file_), sink);
  reader.finish(sink);
  EXPECT_EQ(slots, 70U);
  EXPECT_EQ(reader.counters().skipped_bytes, 0U);
  EXPECT_EQ(reader.header()->garment, "practical");
}

TEST_F(VirtualGarment, AFullDiskIsNamedWithWhatIsThere) {
  if (!fs::exists("/dev/full")) GTEST_SKIP() << "no /dev/full";
  GarmentSignal signal(worn_, 5);
  try {
    (void)write_garment_file(signal, 20, "/dev/full");
    FAIL() << "expected an error";
  } catch (const std::system_error& error) {
    EXPECT_EQ(error.code(), std::errc::no_space_on_device);
    EXPECT_THAT(error.what(), ::testing::HasSubstr("/dev/full: written in part"));
    EXPECT_THAT(error.what(), ::testing::HasSubstr("of 0.2 s"));
  }
  EXPECT_THROW((void)write_garment_file(signal, 1, "/no/such/folder/f.garment"), std::system_error);
}

TEST_F(VirtualGarment, AStoppedFileIsWhole) {
  GarmentSignal signal(worn_, 5);
  std::stop_source stop;
  const auto slots = write_garment_file(signal, 1000, file_, stop.get_token(),
                                        [&](std::uint32_t) { stop.request_stop(); });
  EXPECT_LT(slots, 1000U);
  EXPECT_EQ(fs::file_size(file_), 80 + slots * (20 + 18 * 1120 * 2));
}

// What a reader on the other side got, and what it must hold: slots in order, none of them garbled.
struct Received {
  wire::GarmentStreamReader reader;
  std::uint32_t slots = 0;
  void feed(std::span<const std::uint8_t> bytes) {
    reader.feed(bytes, [&](const wire::GarmentSlot&) { ++slots; });
  }
  void check(const LinkCounters& sent) const {
    EXPECT_GT(slots, 0U);
    EXPECT_LE(slots, sent.slots - sent.dropped);
    EXPECT_EQ(reader.counters().garbled, 0U);
  }
};

TEST_F(VirtualGarment, ServesATcpClient) {
  SignalOptions options;
  options.start_ns = 1'700'000'000'000'000'000;
  GarmentSignal signal(worn_, 5, options);
  auto listener = std::make_unique<wire::TcpListener>(0);
  Received received;
  std::jthread client([&, port = listener->port()] {
    const int fd = ::socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    ASSERT_EQ(::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
    std::array<std::uint8_t, 65536> buffer;
    ssize_t count = 0;
    while ((count = ::recv(fd, buffer.data(), buffer.size(), 0)) > 0) {
      received.feed(std::span(buffer).first(static_cast<std::size_t>(count)));
    }
    ::close(fd);
  });
  const auto sent = serve_garment(signal, 60, *listener,
                                  [&] { return listener->poll() ? listener->openings() : 0; }, {});
  listener.reset();  // hangs up, so that the client ends
  client.join();
  EXPECT_EQ(sent.slots, 60U);
  received.check(sent);
  EXPECT_EQ(received.reader.header()->start_ns, options.start_ns);
}

TEST_F(VirtualGarment, ServesAPseudoTerminal) {
  GarmentSignal signal(worn_, 5);
  wire::PseudoTerminal terminal;
  Received received;
  std::jthread client([&](std::stop_token stop) {
    wire::SerialPort port(terminal.slave_path());
    std::array<std::uint8_t, 65536> buffer;
    const auto start = std::chrono::steady_clock::now();
    while (!stop.stop_requested()) {
      port.poll(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
      const std::size_t count = port.read_some(buffer);
      received.feed(std::span(buffer).first(count));
      if (count == 0) std::this_thread::sleep_for(std::chrono::microseconds(200));
    }
  });
  const auto sent = serve_garment(signal, 40, terminal, [] { return 1U; }, {});
  client.request_stop();
  client.join();
  EXPECT_EQ(sent.slots, 40U);
  received.check(sent);
}

TEST_F(VirtualGarment, DropsWholeSlotsWhenNobodyReads) {
  GarmentSignal signal(worn_, 5);
  wire::TcpListener listener(0);
  const auto sent = serve_garment(signal, 20, listener,
                                  [&] { return listener.poll() ? listener.openings() : 0; }, {});
  EXPECT_EQ(sent.dropped, 20U);
  EXPECT_EQ(sent.bytes, 0U);
}

TEST(TcpListener, NamesAPortThatIsTaken) {
  const wire::TcpListener first(0);
  try {
    const wire::TcpListener second(first.port());
    FAIL() << "expected an error";
  } catch (const std::system_error& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr(std::to_string(first.port())));
  }
}

}  // namespace
}  // namespace secondskin::sim
