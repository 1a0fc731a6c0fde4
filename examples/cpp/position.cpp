// Where an image was taken, by an exported model: ./position model.onnx image.pgm
//
// Needs onnxruntime 1.20 or newer and C++20:
//     g++ -std=c++20 -I onnxruntime/include position.cpp -o position -l onnxruntime
#include <onnxruntime_cxx_api.h>

#include <array>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

struct Image {
  std::int64_t height = 0, width = 0;
  std::vector<std::uint8_t> pixels;
};

Image read_pgm(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::string magic;
  Image image;
  int most = 0;
  file >> magic >> image.width >> image.height >> most;
  const auto fits = [](std::int64_t side) { return 0 < side && side < 65536; };
  if (!file || magic != "P5" || most != 255 || !fits(image.width) || !fits(image.height))
    throw std::runtime_error(path + " must be a grey PGM image of 8 bits without comments");
  file.get();  // the white space before the pixels
  image.pixels.resize(image.width * image.height);
  if (!file.read(reinterpret_cast<char*>(image.pixels.data()), image.pixels.size()))
    throw std::runtime_error(path + " is cut short");
  return image;
}

int main(int argc, char** argv) try {
  if (argc != 3) throw std::runtime_error("usage: position model.onnx image.pgm");
  Ort::Env env(ORT_LOGGING_LEVEL_ERROR, "position");
  Ort::SessionOptions options;
  options.SetIntraOpNumThreads(1);
  Ort::Session session(env, argv[1], options);
  Image image = read_pgm(argv[2]);
  const std::array<std::int64_t, 2> shape{image.height, image.width};
  const auto memory = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
  const auto input = Ort::Value::CreateTensor<std::uint8_t>(
      memory, image.pixels.data(), image.pixels.size(), shape.data(), shape.size());
  const char* taken = "image";
  const std::array<const char*, 4> given{"displacement", "delta_p", "deviation", "is_recognised"};
  // a robot keeps the session, and calls only this for every image; another size throws here
  const Ort::RunOptions usual{nullptr};
  const auto found = session.Run(usual, &taken, &input, 1, given.data(), given.size());
  if (!*found[3].GetTensorData<bool>()) {
    std::puts("not recognised: do not move");
    return 2;
  }
  const double* D = found[0].GetTensorData<double>();  // move by its inverse, in the robot's axes
  for (int k = 0; k < 16; ++k) std::printf("%.9f%c", D[k], k % 4 == 3 ? '\n' : ' ');
  const double* six = found[1].GetTensorData<double>();
  const double* deviation = found[2].GetTensorData<double>();
  const char* names[] = {"tx", "ty", "tz", "rx", "ry", "rz"};
  for (int k = 0; k < 6; ++k)
    std::printf("%s %.9f +- %.9f %s\n", names[k], six[k], deviation[k], k < 3 ? "m" : "rad");
} catch (const std::exception& error) {
  std::fprintf(stderr, "position: %s\n", error.what());
  return 1;
}
